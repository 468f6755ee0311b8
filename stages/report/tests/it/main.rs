//! The kinds run on whole sets of files: what they write, to the byte, and what they say about bad input.

#![allow(clippy::unwrap_used, reason = "a test's own functions may fail the test")]

mod compare;
mod fakes;
mod figure;
mod figure_limits;
mod findings;
mod html;
mod html_limits;
mod lab;
mod labels;
mod leaderboard;
mod select;
mod table;

use dril_report::KINDS;
use dril_stage_api::Registry;

#[test]
fn the_kinds_have_names_of_their_own_and_draw_no_random_numbers() {
    let registry = Registry::new(KINDS).unwrap();
    let names: Vec<&str> = registry.iter().map(dril_stage_api::Kind::name).collect();
    assert_eq!(names, ["compare", "figure", "findings", "leaderboard", "select", "table"]);
    assert!(registry.iter().all(|kind| !kind.seeded() && kind.worker().is_none()));
}
