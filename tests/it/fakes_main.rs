//! The program under test with the fakes as its stage kinds. Built as an example, so that it is never installed.

mod fakes;
mod scenario;

use std::process::ExitCode;
use std::sync::atomic::AtomicBool;

use dril_pipe::exec::{self, ChildRunner, Options};
use dril_pipe::{plan, store::Store};

fn main() -> ExitCode {
    let arguments: Vec<_> = std::env::args_os().collect();
    match arguments.get(1).and_then(|argument| argument.to_str()) {
        Some("__engine") => engine(&arguments[2]),
        Some("__stage") => exec::run_stage(arguments[2].as_ref(), &fakes::registry()),
        _ => dril_pipe::cli::run(fakes::registry(), arguments),
    }
}

/// Runs a scenario without a pipeline file, and prints every event.
fn engine(file: &std::ffi::OsStr) -> ExitCode {
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
    let executed =
        exec::execute(plan, &store, &runner, &options, &stop, &mut |event| println!("{event:?}")).unwrap();
    ExitCode::from(u8::from(!executed.outcome.is_complete()))
}
