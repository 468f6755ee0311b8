//! Landings beside Gymnasium's own game, with the real packages, which the first run installs below the target folder.

#![allow(clippy::unwrap_used, reason = "a test's own functions may fail the test")]

use std::path::PathBuf;

use dril_envs::gymnasium::{self, PythonHome};
use dril_parity::Report;

#[test]
fn a_pilot_lands_as_often_and_as_well_on_500_seeds_of_ours_as_on_500_of_gymnasium_s() {
    let folder = PathBuf::from(env!("CARGO_TARGET_TMPDIR")).join("venvs");
    gymnasium::keep_python_in(PythonHome { folder, python: None });
    let mut report = Report::default();
    dril_parity::landings(&mut report).unwrap();
    let limited: Vec<_> = report.rows.iter().filter(|row| row.limit == Some(3.0)).collect();
    assert_eq!(limited.len(), 2, "{report}");
    assert!(report.passed(), "{report}");
    // A pilot that never lands would be as bad in both.
    assert!(report.rows.iter().any(|row| row.measure.contains("rate") && row.worst > 95.0), "{report}");
}
