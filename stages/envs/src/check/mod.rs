//! Compares the games with recordings of the originals: `dril-pipe env check`.
//!
//! A recording folder holds numpy archives ([`Npz`]) of one or several games; a missing file leaves its part of the
//! [`Report`] out. Where a game cannot be compared move by move, because its random draws are its own, many episodes
//! are compared with as many that Gymnasium plays ([`landings`]).

pub mod car_racing;
pub mod lunar_lander;
mod npz;
mod report;

use std::path::{Path, PathBuf};

pub use npz::{Array, Npz};
pub use report::{Report, Row};

use crate::EnvError;

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
    /// A game cannot be played: most likely the bridge to Gymnasium.
    #[error(transparent)]
    Env(#[from] EnvError),
}

/// Replays every recording of a folder.
///
/// # Errors
/// The folder has no recordings, or one of them cannot be read.
pub fn run(folder: &Path) -> Result<Report, CheckError> {
    std::fs::read_dir(folder).map_err(|source| CheckError::Io { path: folder.to_owned(), source })?;
    let mut report = Report::default();
    let mut found = false;
    if let Some(recordings) = car_racing::Recordings::open(folder)? {
        found = true;
        report.begin("car-racing");
        car_racing::run(&recordings, &mut report)?;
    }
    if let Some(recordings) = lunar_lander::Recordings::open(folder)? {
        found = true;
        report.begin("lunar-lander");
        lunar_lander::run(&recordings, &mut report)?;
    }
    if found {
        Ok(report)
    } else {
        Err(CheckError::Empty {
            path: folder.to_owned(),
            expected: [&car_racing::FILES[..], &[lunar_lander::FILE]].concat().join(", "),
        })
    }
}

/// Compares landings on many seeds with as many in Gymnasium's LunarLander, which the bridge plays now.
///
/// # Errors
/// The bridge cannot play it.
pub fn landings(report: &mut Report) -> Result<(), CheckError> {
    report.begin("lunar-lander, beside Gymnasium");
    lunar_lander::check_gymnasium(report)
}

/// The results of a game's runs; none where the file is not there.
fn read_json<T: serde::de::DeserializeOwned>(path: &Path) -> Result<Option<T>, CheckError> {
    if !path.exists() {
        return Ok(None);
    }
    let text = std::fs::read(path).map_err(|source| CheckError::Io { path: path.to_owned(), source })?;
    serde_json::from_slice(&text)
        .map(Some)
        .map_err(|error| CheckError::Format { name: path.display().to_string(), message: error.to_string() })
}
