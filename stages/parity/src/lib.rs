//! Parity checks: compares the environments with recordings of the original games (`dril-pipe env check`).
//!
//! A folder of recordings holds numpy archives ([`npz`]) of one or several games; where a file is missing, its part of
//! the [`Report`] is left out. A game whose random draws are its own cannot be compared step by step: many episodes are
//! compared with as many that Gymnasium plays ([`landings`]).

pub mod car_racing;
pub mod command;
mod error;
pub mod lunar_lander;
pub mod npz;
mod report;

use std::path::Path;

pub use error::CheckError;
pub use report::{Report, Row};

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
