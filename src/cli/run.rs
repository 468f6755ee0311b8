//! `dril-pipe run`: brings every stage of a pipeline up to date and copies its results.

use std::process::ExitCode;

use dril_stage_api::Registry;

use super::args::RunArgs;
use super::report::{self, Ending};
use super::{pipeline, results, signals};
use crate::error::{Error, ErrorKind, exit_codes};
use crate::exec::{self, ChildRunner, Executed, Options};
use crate::plan;

pub(super) fn main(args: &RunArgs, registry: &Registry) -> Result<ExitCode, Error> {
    let graph = pipeline::load(&args.pipeline, registry)?;
    let store = pipeline::store(&args.store)?;
    let plan = plan::plan(&graph, &store, &pipeline::base(&args.pipeline))?;
    let options = options(args);
    let mut reporter = report::choose(args, &graph);
    reporter.planned(&plan, options.threads);
    let runner = ChildRunner::this_program()
        .map_err(|error| Error::new(ErrorKind::Io, format!("cannot find this program's file: {error}")))?;
    let stop = signals::stop_flag()?;
    let executed = exec::execute(plan, &store, &runner, &options, &stop, &mut |event| reporter.event(event))?;
    let folder = args.out.clone().unwrap_or_else(|| results::default_folder(&graph));
    let published = results::publish(&folder, &graph, &store, |stage| executed.outputs(stage));
    let (published, error) = match published {
        Ok(published) => (published, None),
        Err(error) => (None, Some(error)),
    };
    // The work is done and in the store: its end is told, whatever became of the copies.
    let exit_code = error.as_ref().map_or_else(|| exit_code(&executed), |error| error.kind().exit_code());
    let (published, error) = (published.as_ref(), error.as_ref());
    reporter.ended(&Ending { executed: &executed, published, error, exit_code });
    Ok(ExitCode::from(exit_code))
}

fn options(args: &RunArgs) -> Options {
    let mut options = Options {
        checkpoint_seconds: args.checkpoint_every,
        keep_going: !args.fail_fast,
        ..Options::default()
    };
    if let Some(jobs) = args.jobs {
        options.threads = jobs.get();
    }
    options
}

/// A stop outranks a failure: the run is not over, and what failed is tried again by the next one anyway.
fn exit_code(executed: &Executed) -> u8 {
    let outcome = &executed.outcome;
    if outcome.is_complete() {
        exit_codes::OK
    } else if outcome.stopped > 0 {
        exit_codes::INTERRUPTED
    } else {
        exit_codes::STAGE_FAILED
    }
}
