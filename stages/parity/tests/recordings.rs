//! The game against recordings of the original: a part of the whole set, with one test per tolerance.

#![allow(clippy::expect_used)]

use std::path::Path;
use std::sync::LazyLock;

use dril_parity::{CheckError, Report};

static REPORT: LazyLock<Report> = LazyLock::new(|| replay("traces"));
/// Recordings in which the steering is pressed against its stop and called back slowly.
static STOPS: LazyLock<Report> = LazyLock::new(|| replay("traces-stops"));

fn replay(folder: &str) -> Report {
    let tests = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests");
    dril_parity::run(&tests.join(folder)).expect("the recordings are there")
}

/// Every row of the script with the measure is within `limit`, and there is one.
fn holds(script: &str, measure: &str, limit: f64) {
    holds_in(&REPORT, script, measure, limit);
}

fn holds_in(report: &Report, script: &str, measure: &str, limit: f64) {
    let rows: Vec<_> =
        report.rows.iter().filter(|row| row.script == script && row.measure.starts_with(measure)).collect();
    assert!(!rows.is_empty(), "no row `{script}: {measure}` in\n{report}");
    for row in rows {
        let worst = row.worst;
        assert!(worst <= limit, "{script}: {measure} is {worst}, expected at most {limit}\n{report}");
    }
}

const SCRIPTS: [&str; 5] = ["full_gas", "gas_brake", "random_iid", "random_smooth", "steer_left_half_gas"];

#[test]
fn recorded_draws_give_the_recorded_track() {
    for measure in ["way points", "tiles", "kerbs", "kerb colours"] {
        holds("tracks", measure, 1e-6);
    }
}

#[test]
fn own_seeds_give_tracks_like_the_original() {
    holds("own tracks", "attempts accepted", 1.5);
    holds("own tracks", "tiles", 4.0);
    holds("own tracks", "length off 3.5 a tile, mean share", 0.01);
    holds("own tracks", "mean turn off recorded", 15.0);
}

#[test]
fn the_start_after_the_reset_is_the_original_s() {
    SCRIPTS.iter().for_each(|script| holds(script, "pose at 0", 1e-4));
}

#[test]
fn full_gas_stays_within_1_cm_for_50_steps_and_5_cm_for_100() {
    holds("full_gas", "pose at 50", 0.01);
    holds("full_gas", "pose at 100", 0.05);
}

#[test]
fn every_script_ends_within_10_cm_after_300_steps() {
    // More than was asked for; slides and spins included.
    SCRIPTS.iter().for_each(|script| holds(script, "pose at 300", 0.1));
}

#[test]
fn a_joint_pressed_against_its_stop_is_held_for_as_long_as_in_the_original() {
    for script in ["random_smooth", "stop_edge", "stop_ease"] {
        holds_in(&STOPS, script, "pose at 100", 0.01);
        holds_in(&STOPS, script, "tiles visited", 0.0);
        holds_in(&STOPS, script, "reward while tiles agree", 1e-9);
    }
    holds_in(&STOPS, "stop_ease", "pose at 200", 0.01);
}

#[test]
fn one_step_of_tyres_and_joints_is_the_original_s() {
    holds("one step", "wheel speeds", 1e-3);
    holds("one step", "hull velocity", 1e-3);
    holds("one step", "steering angle", 1e-3);
}

#[test]
fn recorded_poses_touch_the_recorded_tiles() {
    holds("recorded poses", "tiles visited", 0.0);
    holds("recorded poses", "moments with other contacts", 1.0);
}

#[test]
fn replayed_runs_visit_the_recorded_number_of_tiles() {
    SCRIPTS.iter().for_each(|script| holds(script, "tiles visited", 1.0));
}

#[test]
fn rewards_are_paid_in_the_recorded_steps() {
    SCRIPTS.iter().for_each(|script| holds(script, "reward while tiles agree", 1e-9));
}

#[test]
fn the_described_driver_finishes_his_laps_with_the_recorded_return() {
    holds("closed_loop", "laps not finished", 0.0);
    holds("closed_loop", "return", 15.0);
}

#[test]
fn images_of_version_0_agree_in_999_of_1000_pixels() {
    for script in ["gas_brake", "random_smooth", "steer_left_half_gas"] {
        holds(script, "v0 pixels off by more than 1", 0.1);
    }
}

#[test]
fn images_of_version_3_agree_in_98_of_100_pixels() {
    for script in ["full_gas", "random_iid", "random_smooth"] {
        holds(script, "v3 pixels off by more than 8", 2.0);
    }
}

#[test]
fn the_lander_starts_as_the_original_s() {
    for measure in ["ground", "lander's pose", "legs' angles", "velocities"] {
        holds("start", measure, 1e-4);
    }
}

#[test]
fn the_falling_lander_is_within_a_thousandth_until_it_touches() {
    holds("noop", "observations before contact", 1e-3);
}

#[test]
fn the_pilot_lands_where_the_original_does_with_its_return() {
    holds("heuristic", "not landed, closed loop", 0.0);
    holds("heuristic", "return, closed loop", 5.0);
}

#[test]
fn own_landings_are_as_many_and_as_good_as_the_original_s() {
    holds("own seeds", "landing rate", 3.0);
    holds("own seeds", "mean return", 3.0);
}

#[test]
fn a_folder_without_recordings_is_an_error_that_names_them() {
    let folder = tempfile::tempdir().expect("a folder");
    let error = dril_parity::run(folder.path()).expect_err("there is nothing");
    assert!(
        matches!(error, CheckError::Empty { .. }) && error.to_string().contains("car_tracks.npz"),
        "{error}"
    );
    std::fs::write(folder.path().join("car_tracks.npz"), b"not an archive").expect("written");
    let error = dril_parity::run(folder.path()).expect_err("that is no archive").to_string();
    assert!(error.contains("car_tracks.npz: not a zip archive"), "{error}");
}
