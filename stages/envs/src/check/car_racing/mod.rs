//! CarRacing against recordings of the original: tracks, motion, tiles, rewards and pictures.

mod chaos;
mod contacts;
mod laps;
mod motion;
mod own_tracks;
mod pixels;
mod recording;
mod tracks;
mod watched;

pub use recording::{FILES, Meta, Recordings, Run};

use super::{Array, CheckError, Npz, Report};

/// Replays every recording.
///
/// # Errors
/// One of them cannot be read.
pub fn run(recordings: &Recordings, report: &mut Report) -> Result<(), CheckError> {
    tracks::check(recordings, report)?;
    own_tracks::check(recordings, report)?;
    motion::check(recordings, report)?;
    contacts::check(recordings, report)?;
    chaos::check(recordings, report)?;
    laps::check(recordings, report)?;
    pixels::check(recordings, report)
}
