//! Evaluations made up for the tests.

use std::path::{Path, PathBuf};

use dril_stage_api::scores::{self, ScoreRow};
use dril_stage_api::testing::Bench;

/// The axes of the thesis's table of all policies, in the order of its matrix.
pub const AXES: [(&str, &[&str]); 5] = [
    ("expert", &["clipped", "bounded"]),
    ("method", &["bc", "dril-peak", "dril-final"]),
    ("mode", &["deterministic", "stochastic"]),
    ("policy", &["gaussian", "beta"]),
    ("demonstrations", &["1", "20"]),
];

/// A file of the tests' reference folder, which holds copies of the thesis's numbers.
pub fn reference(name: &str) -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/it/reference").join(name)
}

/// Labels, the last axis the fastest.
pub fn matrix() -> Vec<Vec<(&'static str, &'static str)>> {
    AXES.iter().fold(vec![Vec::new()], |rows, (axis, values)| {
        rows.iter()
            .flat_map(|row: &Vec<_>| {
                values.iter().map(move |value| [row.as_slice(), &[(*axis, *value)]].concat())
            })
            .collect()
    })
}

/// Writes an evaluation with these scores into the bench's folder.
pub fn scores(bench: &Bench, name: &str, values: &[f64]) -> PathBuf {
    written(bench, name, values, None)
}

/// The same of an agent whose training diverged.
pub fn diverged_scores(bench: &Bench, name: &str, values: &[f64]) -> PathBuf {
    written(bench, name, values, Some(8192))
}

fn written(bench: &Bench, name: &str, values: &[f64], diverged_at_step: Option<u64>) -> PathBuf {
    let path = bench.folder().join(format!("{name}.csv"));
    let row = |(episode, score): (usize, &f64)| ScoreRow {
        episode,
        seed: 2_000_000 + episode as u64,
        score: *score,
        steps: 1000,
        outcome: "time-limit".into(),
        diverged_at_step,
    };
    scores::write(&path, &values.iter().enumerate().map(row).collect::<Vec<_>>()).unwrap();
    path
}

/// An evaluation of 100 episodes with exactly this mean and this population standard deviation.
pub fn spread(mean: f64, std: f64) -> Vec<f64> {
    (0..100).map(|n| if n % 2 == 0 { mean - std } else { mean + std }).collect()
}

/// The mean and std that the thesis's table of all policies gives for these labels.
pub fn reported(labels: &[(&str, &str)]) -> (f64, f64) {
    let text = std::fs::read_to_string(reference("table22.csv")).unwrap();
    let key: Vec<&str> = labels.iter().map(|(_, value)| *value).collect();
    let line = text.lines().find(|line| line.starts_with(&(key.join(",") + ","))).unwrap();
    let numbers: Vec<f64> = line.split(',').skip(5).map(|cell| cell.parse().unwrap()).collect();
    (numbers[0], numbers[1])
}

/// The text of an output.
pub fn output(bench: &Bench, port: &str) -> String {
    std::fs::read_to_string(bench.output(port).unwrap()).unwrap()
}
