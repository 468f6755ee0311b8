//! Compares CarRacing with recordings of the original: tracks, motion, tiles, rewards and pictures.
//!
//! A recording folder holds `car_tracks.npz`, `car_traces.npz`, `car_v0_frames.npz`, `car_frames.npz` and
//! `car_meta.json`; a missing file leaves its part of the report out.

mod chaos;
mod contacts;
mod driver;
mod laps;
mod motion;
mod npz;
mod own_tracks;
mod pixels;
mod recording;
mod report;
mod tracks;
mod watched;

use std::path::{Path, PathBuf};

pub use driver::drive;
pub use npz::{Array, Npz};
pub use recording::{Meta, Recordings, Run};
pub use report::{Report, Row};

/// Why recordings cannot be compared.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum CheckError {
    /// A file cannot be read.
    #[error("cannot read {path}: {source}", path = path.display())]
    Io {
        /// The file.
        path: PathBuf,
        /// The system's answer.
        source: std::io::Error,
    },
    /// A file is not what it should be.
    #[error("{name}: {message}")]
    Format {
        /// The file, and the array in it.
        name: String,
        /// What was seen and what was expected.
        message: String,
    },
    /// A folder without recordings.
    #[error("{path} holds no recordings: none of {expected} is there", path = path.display())]
    Empty {
        /// The folder.
        path: PathBuf,
        /// Files looked for.
        expected: String,
    },
}

/// Replays every CarRacing recording of a folder.
///
/// # Errors
/// The folder has no recordings, or one of them cannot be read.
pub fn run(folder: &Path) -> Result<Report, CheckError> {
    let recordings = Recordings::open(folder)?;
    let mut report = Report::default();
    tracks::check(&recordings, &mut report)?;
    own_tracks::check(&recordings, &mut report)?;
    motion::check(&recordings, &mut report)?;
    contacts::check(&recordings, &mut report)?;
    chaos::check(&recordings, &mut report)?;
    laps::check(&recordings, &mut report)?;
    pixels::check(&recordings, &mut report)?;
    Ok(report)
}
