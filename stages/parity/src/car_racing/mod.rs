//! CarRacing against recordings of the original: tracks, motion, tiles, rewards and images.

mod chaos;
mod contacts;
mod laps;
mod motion;
mod own_tracks;
mod pixels;
mod playback;
mod recording;
mod tracks;

pub use recording::{FILES, Meta, Recordings, Run};

use crate::error::CheckError;
use crate::report::Report;

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
