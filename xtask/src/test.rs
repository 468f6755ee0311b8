//! `cargo xtask test`: what has to pass before a change lands. Cheap checks first; a failure does not stop the rest.

use std::path::Path;
use std::time::{Duration, Instant};

use crate::error::Error;
use crate::{libtorch, pages, process};

/// One check: what it is called in the summary, and cargo's arguments.
struct Step {
    name: &'static str,
    args: &'static str,
    /// A toolchain component that may be missing, by its cargo command and its name in rustup.
    component: Option<(&'static str, &'static str)>,
}

const STEPS: [Step; 6] = [
    Step { name: "format", args: "fmt --all --check", component: Some(("fmt", "rustfmt")) },
    // The engine builds and passes without rapier2d and libtorch, so its failures show within seconds.
    Step {
        name: "engine",
        args: "test --no-fail-fast --package dril-pipe --no-default-features",
        component: None,
    },
    Step {
        name: "small packages",
        args: "test --no-fail-fast --package xtask --package dril-stage-api --package dril-report",
        component: None,
    },
    // Off by default, so nothing else builds it. The filter comes after `--`: before it, cargo would not build the
    // example that the tests start. With a server, `tests/remote/s3.sh` tests more.
    Step {
        name: "shared cache",
        args: "test --no-fail-fast --package dril-pipe --no-default-features --features remote -- remote",
        component: None,
    },
    Step {
        name: "lints",
        args: "clippy --workspace --all-targets --keep-going -- --deny warnings",
        component: Some(("clippy", "clippy")),
    },
    Step {
        name: "workspace",
        args: "test --no-fail-fast --workspace --exclude xtask --exclude dril-stage-api --exclude dril-report",
        component: None,
    },
];

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Outcome {
    Passed,
    Failed,
    Skipped,
}

/// Runs every step and prints a summary.
///
/// # Errors
/// [`Error::Steps`] names the steps that failed; a skipped one (a component is missing) is reported, but no failure.
pub fn run(root: &Path) -> Result<(), Error> {
    libtorch::ensure(root)?;
    let mut results: Vec<_> = STEPS.iter().map(|step| run_step(root, step)).collect();
    results.push(check_pages(root));
    println!("\n{}", summary(&results));
    let failed = results.iter().filter(|result| result.1 == Outcome::Failed).map(|result| result.0).collect();
    verdict(failed)
}

fn run_step(root: &Path, step: &Step) -> (&'static str, Outcome, Duration) {
    let start = Instant::now();
    println!();
    let outcome = match step.component {
        Some((command, component)) if !is_installed(root, command) => {
            println!("SKIPPED `{}`: `rustup component add {component}` would install it", step.args);
            Outcome::Skipped
        }
        _ => match process::run(&mut process::cargo(root, &step.args.split(' ').collect::<Vec<_>>())) {
            Ok(()) => Outcome::Passed,
            Err(error) => {
                eprintln!("error: {error}");
                Outcome::Failed
            }
        },
    };
    (step.name, outcome, start.elapsed())
}

/// Report pages in a browser, where there is one.
fn check_pages(root: &Path) -> (&'static str, Outcome, Duration) {
    let start = Instant::now();
    println!();
    let outcome = match pages::check(root) {
        Ok(None) => Outcome::Passed,
        Ok(Some(reason)) => {
            println!("SKIPPED report pages in a browser: {reason}");
            Outcome::Skipped
        }
        Err(error) => {
            eprintln!("error: {error}");
            Outcome::Failed
        }
    };
    ("pages", outcome, start.elapsed())
}

fn is_installed(root: &Path, command: &str) -> bool {
    process::output(&mut process::cargo(root, &[command, "--version"])).is_some()
}

fn summary(results: &[(&'static str, Outcome, Duration)]) -> String {
    let line = |(name, outcome, took): &(&str, Outcome, Duration)| {
        let word = match outcome {
            Outcome::Passed => "passed",
            Outcome::Failed => "FAILED",
            Outcome::Skipped => "SKIPPED",
        };
        format!("{word:<8} {name:<16} {:>7.1} s", took.as_secs_f64())
    };
    results.iter().map(line).collect::<Vec<_>>().join("\n")
}

fn verdict(failed: Vec<&'static str>) -> Result<(), Error> {
    if failed.is_empty() { Ok(()) } else { Err(Error::Steps { failed }) }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn one_failed_step_fails_the_command_and_is_named() {
        assert!(verdict(Vec::new()).is_ok());
        let error = verdict(vec!["lints"]).unwrap_err();
        assert_eq!((error.exit_code(), error.to_string().as_str()), (1, "failed: lints"));
    }

    #[test]
    fn the_summary_has_a_line_and_seconds_for_every_step() {
        let took = Duration::from_millis(1500);
        let text = summary(&[("format", Outcome::Passed, took), ("lints", Outcome::Skipped, took)]);
        assert_eq!(text.lines().count(), 2);
        assert!(text.lines().all(|line| line.ends_with("1.5 s")));
        assert!(text.contains("SKIPPED"));
    }

    #[test]
    fn packages_tested_early_are_left_out_of_the_last_step_and_no_others() {
        let after = |step: &Step, flag: &str| -> Vec<&str> {
            let words: Vec<_> = step.args.split(' ').collect();
            words.windows(2).filter(|pair| pair[0] == flag).map(|pair| pair[1]).collect()
        };
        assert_eq!(after(&STEPS[2], "--package"), after(&STEPS[5], "--exclude"));
    }
}
