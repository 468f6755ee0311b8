//! `cache doctor`: what it measures on one machine, and with a second process that attends.

use std::collections::BTreeMap;
use std::path::Path;
use std::process::{Command, Stdio};

use serde_json::Value;

use crate::lab::fakes_program;

fn doctor(folder: &Path, more: &[&str]) -> Command {
    let mut command = Command::new(fakes_program());
    command.args(["cache", "doctor"]).arg(folder).args(more).stdin(Stdio::null());
    command
}

/// Health by name of the check.
fn health(folder: &Path) -> BTreeMap<String, String> {
    let output = doctor(folder, &["--json"]).output().unwrap();
    let error = String::from_utf8_lossy(&output.stderr);
    let value: Value = serde_json::from_slice(&output.stdout).unwrap_or_else(|_| panic!("{error}"));
    let text = |check: &Value, field: &str| check[field].as_str().unwrap().to_owned();
    let checks = value["checks"].as_array().unwrap();
    let health: BTreeMap<String, String> =
        checks.iter().map(|check| (text(check, "name"), text(check, "health"))).collect();
    let fails = health.values().any(|health| health == "fails");
    assert_eq!(output.status.code(), Some(if fails { 5 } else { 0 }), "{checks:?}");
    health
}

#[test]
fn the_doctor_measures_a_sound_file_system_and_leaves_nothing_there() {
    let folder = tempfile::tempdir().unwrap();
    let health = health(folder.path());
    for needed in ["create", "rename", "time", "move", "flock"] {
        assert_eq!(health[needed], "ok", "{needed}");
    }
    assert_eq!(health["peer"], "unknown");
    assert_eq!(std::fs::read_dir(folder.path()).unwrap().count(), 0);
    let output = doctor(folder.path(), &[]).output().unwrap();
    let text = String::from_utf8(output.stdout).unwrap();
    assert!(text.contains("100 of 100 files had one creator") && text.contains("--peer"), "{text}");
}

#[test]
fn two_doctors_measure_what_one_sees_of_the_other() {
    let folder = tempfile::tempdir().unwrap();
    let peer = doctor(folder.path(), &["--peer"]).stdout(Stdio::piped()).spawn().unwrap();
    let place = folder.path().join(".dril-doctor");
    while std::fs::read_dir(&place).map_or(0, Iterator::count) == 0 {
        std::thread::sleep(std::time::Duration::from_millis(5));
    }
    let health = health(folder.path());
    for check in ["visible", "current", "one clock", "create, both", "flock, both"] {
        assert_eq!(health.get(check).map(String::as_str), Some("ok"), "{check}: {health:?}");
    }
    let output = peer.wait_with_output().unwrap();
    assert!(output.status.success());
    assert!(String::from_utf8(output.stdout).unwrap().starts_with("took part"));
    assert_eq!(std::fs::read_dir(folder.path()).unwrap().count(), 0);
}

#[test]
fn the_doctor_says_why_it_cannot_measure() {
    let folder = tempfile::tempdir().unwrap();
    let output = doctor(&folder.path().join("nowhere"), &[]).output().unwrap();
    assert_eq!(output.status.code(), Some(4));
    let error = String::from_utf8(output.stderr).unwrap();
    assert!(error.contains("nowhere`: No such file or directory"), "{error}");
}
