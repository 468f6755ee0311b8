//! LunarLander against recordings of the original: ground, start, flight, landings and returns.

mod flight;
mod landings;
mod recording;
mod start;

pub use landings::{Landings, check_gymnasium, land, own_landings};
pub use recording::{FILE, Recordings, Run};

use crate::error::CheckError;
use crate::report::Report;

/// Replays every recording.
///
/// # Errors
/// One of them cannot be read.
pub fn run(recordings: &Recordings, report: &mut Report) -> Result<(), CheckError> {
    start::check(recordings, report)?;
    flight::check(recordings, report)?;
    landings::check(recordings, report)
}
