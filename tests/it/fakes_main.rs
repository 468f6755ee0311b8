//! The program under test with the fakes as its stage kinds. Built as an example, so that it is never installed.
//!
//! `fakes __engine SCENARIO` runs a scenario without a pipeline file; with `DRIL_FAKES_CRASH_AT=N` it dies at the Nth step
//! that touches the disk, with `DRIL_FAKES_FULL_AT=N` it finds the disk full from there on. With `DRIL_FAKES_KINDS=samples` it offers the kinds of `samples` instead.
//!
//! With `DRIL_FAKES_MACHINE=FOLDER` it acts as if it ran on another machine, with kernel locks of its own in that folder (or none, where
//! there is no such folder), and with `DRIL_FAKES_PATIENCE` milliseconds until a silent lease is dead.
#![allow(clippy::unwrap_used, clippy::print_stdout)]

mod fakes;
mod samples;
mod scenario;

use std::process::ExitCode;
use std::sync::atomic::AtomicBool;

use dril_pipe::exec::{self, ChildRunner, Options};
use dril_pipe::{plan, store::Store};
use dril_stage_api::outcome::PipelineOutcome;

fn main() -> ExitCode {
    #[cfg(debug_assertions)]
    if let Some(folder) = std::env::var_os("DRIL_FAKES_MACHINE").map(std::path::PathBuf::from) {
        let patience = std::env::var("DRIL_FAKES_PATIENCE").unwrap().parse().unwrap();
        dril_pipe::fsx::fault::run_on(dril_pipe::fsx::fault::Machine {
            name: folder.file_name().unwrap().to_string_lossy().into_owned(),
            locks: folder.is_dir().then_some(folder),
            patience: std::time::Duration::from_millis(patience),
        });
    }
    let arguments: Vec<_> = std::env::args_os().collect();
    if std::env::var_os("DRIL_FAKES_PAGE").is_some() {
        dril_pipe::cli::keep_page(page, MARK);
    }
    match arguments.get(1).and_then(|argument| argument.to_str()) {
        Some("__engine") => engine(&arguments[2]),
        Some("__stage") => exec::run_stage(arguments[2].as_ref(), &fakes::registry()),
        _ if std::env::var_os("DRIL_FAKES_KINDS").is_some_and(|kinds| kinds == "samples") => {
            dril_pipe::cli::run(samples::registry(), arguments)
        }
        Some("__peek") => {
            println!("{}", arguments[2].to_string_lossy());
            ExitCode::SUCCESS
        }
        _ => {
            let extensions = dril_pipe::cli::Extensions { commands: &[], tools: &[fakes::PEEK] };
            dril_pipe::cli::run_with(fakes::registry(), extensions, arguments)
        }
    }
}

/// The first line of the pages of the stand-in.
const MARK: &str = "<!-- page -->\n";

/// A page that says what it was handed.
fn page(
    outcome: &PipelineOutcome,
    other: Option<(&str, &PipelineOutcome)>,
) -> Result<String, dril_stage_api::StageError> {
    let first = outcome.first_profile.as_deref().unwrap_or("none");
    let command = outcome.command.join(" ");
    let mut page = format!("{MARK}{} {} of {first}, {command}\n", outcome.pipeline, outcome.profile);
    for stage in &outcome.stages {
        page += &format!("{}: {:?}", stage.id, stage.state);
        page.extend(stage.chosen.iter().map(|(name, value)| format!(" {name}={value}")));
        for input in &stage.inputs {
            let from = input.stage.map_or("file", |at| &outcome.stages[at].id);
            page += &format!(" reads {from}.{}", input.from);
        }
        for output in &stage.outputs {
            assert_eq!(std::fs::metadata(&output.path).map(|file| file.len()).ok(), Some(output.bytes));
            page.extend(output.file.iter().map(|file| format!(" file {file}")));
        }
        page.push('\n');
    }
    if let Some((name, other)) = other {
        page += &format!("against {name}\n");
        for stage in &other.stages {
            page += &format!(
                "{}: {:?} {:?}\n",
                stage.id,
                stage.labels,
                stage.outputs.iter().map(|o| o.bytes).collect::<Vec<_>>()
            );
        }
    }
    Ok(page)
}

/// Runs a scenario without a pipeline file, and prints every event.
fn engine(file: &std::ffi::OsStr) -> ExitCode {
    #[cfg(debug_assertions)]
    if let Ok(nth) = std::env::var("DRIL_FAKES_CRASH_AT") {
        dril_pipe::fsx::fault::arm(nth.parse().unwrap());
    }
    #[cfg(debug_assertions)]
    if let Ok(nth) = std::env::var("DRIL_FAKES_FULL_AT") {
        dril_pipe::fsx::fault::fill(nth.parse().unwrap());
    }
    let scenario: scenario::Scenario = serde_json::from_slice(&std::fs::read(file).unwrap()).unwrap();
    let store = Store::open(&scenario.store).unwrap();
    let graph = scenario::graph(&scenario.stages);
    let plan = plan::plan(&graph, &store, &scenario.base).unwrap();
    let options = Options {
        threads: scenario.threads,
        checkpoint_seconds: scenario.checkpoint_seconds,
        ..Options::default()
    };
    let runner = ChildRunner::this_program().unwrap();
    let stop = AtomicBool::new(false);
    let executed = exec::execute(plan, &store, &runner, &options, &stop, &mut |event| println!("{event:?}"));
    let executed = match executed {
        Ok(executed) => executed,
        Err(error) => {
            println!("{error}");
            return ExitCode::from(4);
        }
    };
    ExitCode::from(u8::from(!executed.outcome.is_complete()))
}
