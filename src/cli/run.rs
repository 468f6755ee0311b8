//! `dril-pipe run`: brings every stage of a pipeline up to date and copies its results.

use std::path::PathBuf;
use std::process::ExitCode;
use std::time::Instant;

use dril_stage_api::Registry;
use serde_json::{Map, Value, json};

use super::args::RunArgs;
use super::lockfile::{self, Keys, LockFile};
use super::pipeline::Reading;
use super::report::{self, Ending, Left};
use super::unchanged::Circumstances;
use super::{checked, page, pipeline, resources, results, signals};
use crate::error::{Error, ErrorKind, exit_codes};
use crate::exec::{self, ChildRunner, Executed, Options};
use crate::fsx;
use crate::plan::{self, Estimates, Plan, Verdict};
use crate::resolve::Graph;
use crate::store::Store;

pub(super) fn main(args: &RunArgs, registry: &Registry) -> Result<ExitCode, Error> {
    let began = Instant::now();
    let circumstances = Circumstances::of(args);
    if let Some(circumstances) = &circumstances
        && circumstances.tell(args, began)?
    {
        return Ok(ExitCode::SUCCESS);
    }
    let store = pipeline::store(&args.store)?;
    let mut reading = Reading::from(&store);
    let selected = pipeline::select(&args.pipeline, &args.select, registry, &mut reading)?;
    let graph = &selected.graph;
    let plan = pipeline::plan(&selected, &store, &args.pipeline)?;
    if args.dry_run {
        super::plan::show(&plan, &store, args.json, false)?;
        return Ok(ExitCode::SUCCESS);
    }
    // Only of a file that did not change while it was read.
    let circumstances = circumstances.filter(|before| Circumstances::of(args).as_ref() == Some(before));
    let parts = super::unchanged::read_from(&reading.parts, &plan);
    let lock = Locked::read(args)?;
    lock.check_plan(&plan)?;
    let folder = results_folder(args, graph)?;
    let options = options(args, began)?;
    let mut reporter = report::choose(args, graph);
    reporter.planned(&plan, options.threads);
    let runner = runner()?;
    let stop = signals::stop_flag()?;
    let executed = std::thread::scope(|scope| {
        // Stages are waited for anyway, and a run that is cut off has read the file, too.
        scope.spawn(|| reading.keep());
        exec::execute(plan, &store, &runner, &options, &stop, &mut |event| reporter.event(event))
    })?;
    let place = |stage| executed.outputs(selected.place(stage)?);
    let (published, mut error) =
        match results::publish(&folder, &args.pipeline.file, selected.all(), &store, place) {
            Ok(published) => (published, None),
            Err(failed) => (None, Some(failed)),
        };
    if error.is_none() && selected.whole.is_none() {
        error = lock.settle(graph, &executed).err();
    }
    let left =
        if executed.outcome.out_of_time { left(args, graph, &store, options.threads).ok() } else { None };
    if let Some(circumstances) = circumstances.filter(|_| error.is_none() && executed.outcome.is_complete()) {
        circumstances.note(graph, &store, parts, &executed, published.as_ref());
    }
    // The work is done and in the store: its end is told, whatever became of the copies.
    let mut code = error.as_ref().map_or_else(|| exit_code(&executed), |error| error.kind().exit_code());
    let ending = Ending {
        executed: &executed,
        published: published.as_ref(),
        error: error.as_ref(),
        left: left.as_ref(),
        exit_code: code,
    };
    reporter.ended(&ending);
    page::after_run(args, selected.all(), &store, &folder);
    if args.check_determinism && code == exit_codes::OK {
        drop(reporter);
        code = checked::main(args, graph, &store, &runner, &options, &stop)?;
    }
    Ok(ExitCode::from(code))
}

/// Where the results go: a folder that is not another pipeline's.
fn results_folder(args: &RunArgs, graph: &Graph) -> Result<PathBuf, Error> {
    let folder = args.out.clone().unwrap_or_else(|| results::default_folder(graph));
    results::check_owner(&folder, &args.pipeline.file, graph)?;
    Ok(folder)
}

fn runner() -> Result<ChildRunner, Error> {
    // This program starts nothing but stages while it runs them.
    exec::claim_all_children();
    ChildRunner::this_program()
        .map_err(|error| Error::new(ErrorKind::Io, format!("cannot find this program's file: {error}")))
}

fn options(args: &RunArgs, began: Instant) -> Result<Options, Error> {
    // Stages run in folders of their own.
    let curves = args.tensorboard.as_ref().map(std::path::absolute).transpose().map_err(|error| {
        Error::new(ErrorKind::Io, format!("`--tensorboard`: the current folder cannot be named: {error}"))
    })?;
    let mut options = Options {
        checkpoint_seconds: args.checkpoint_every,
        curves,
        keep_going: !args.fail_fast,
        deadline: args.time.and_then(|time| began.checked_add(time)),
        resources: resources::units(&args.resources)?,
        about: about(args),
        ..Options::default()
    };
    if let Some(jobs) = args.jobs {
        options.threads = jobs.get();
    }
    Ok(options)
}

/// Where the plan comes from, for the notes of the run: an archive of it carries the pipeline file along.
fn about(args: &RunArgs) -> Map<String, Value> {
    let source = fsx::read(&args.pipeline.file).ok().and_then(|bytes| String::from_utf8(bytes).ok());
    let mut about = Map::new();
    about.insert("file".to_owned(), json!(args.pipeline.file.to_string_lossy()));
    about.insert("set".to_owned(), json!(args.pipeline.choices().set));
    about.insert("source".to_owned(), json!(source));
    about
}

/// A stop outranks a failure: the run is not over, and what failed is tried again by the next one anyway.
fn exit_code(executed: &Executed) -> u8 {
    let outcome = &executed.outcome;
    if outcome.is_complete() {
        exit_codes::OK
    } else if outcome.out_of_time {
        exit_codes::OUT_OF_TIME
    } else if outcome.stopped > 0 {
        exit_codes::INTERRUPTED
    } else {
        exit_codes::STAGE_FAILED
    }
}

/// What a run whose time is over leaves to the next one.
fn left(args: &RunArgs, graph: &Graph, store: &Store, threads: usize) -> Result<Left, Error> {
    let plan = plan::plan(graph, store, &pipeline::base(&args.pipeline))?;
    let stale = |stage| !matches!(plan.verdict(stage), Some(Verdict::Cached { .. }));
    let (time, unknown) = Estimates::of(&plan, store)?.together(&plan, threads, stale);
    Ok(Left {
        stages: graph.stages.node_indices().filter(|stage| stale(*stage)).collect(),
        time,
        unknown,
        threads,
    })
}

/// What a run has to do with the lock file beside the pipeline.
struct Locked {
    path: PathBuf,
    there: Option<LockFile>,
    /// `--locked`: it must hold.
    must_hold: bool,
    /// It is written anew: `--lock`, or it is there and the run is of the file as it stands.
    write: bool,
}

impl Locked {
    fn read(args: &RunArgs) -> Result<Self, Error> {
        let path = lockfile::path_of(&args.pipeline.file);
        let there = LockFile::read(&path)?;
        if args.locked && there.is_none() {
            let text = format!("there is no lock file `{}`", path.display());
            return Err(Error::new(ErrorKind::Check, text).hint("`dril-pipe run --lock` writes one"));
        }
        let as_it_stands = args.pipeline.choices().set.is_empty();
        let write = !args.locked && (args.lock || there.is_some() && as_it_stands);
        Ok(Self { path, there, must_hold: args.locked, write })
    }

    fn check_plan(&self, plan: &Plan<'_>) -> Result<(), Error> {
        match self.there.as_ref().filter(|_| self.must_hold).map(|lock| lock.against_plan(plan)) {
            Some(found) if !found.is_empty() => Err(lockfile::differs(&self.path, found)),
            _ => Ok(()),
        }
    }

    /// Compares what was made with the lock file, or writes it into it.
    fn settle(&self, graph: &Graph, executed: &Executed) -> Result<(), Error> {
        let keys: Keys = graph
            .stages
            .node_indices()
            .zip(&executed.keys)
            .filter_map(|(stage, key)| Some((stage, (*key)?)))
            .collect();
        if let Some(lock) = self.there.as_ref().filter(|_| self.must_hold) {
            let found = lock.against_results(graph, &keys, executed);
            if !found.is_empty() {
                return Err(lockfile::differs(&self.path, found));
            }
        }
        if self.write {
            let mut lock = self.there.clone().unwrap_or_default();
            lock.take_over(graph, &keys, executed, executed.outcome.is_complete());
            if self.there.as_ref() != Some(&lock) {
                fsx::write_atomic(&self.path, lock.text().as_bytes())?;
            }
        }
        Ok(())
    }
}
