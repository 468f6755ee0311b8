//! Runs a plan: one dispatcher owns the state, stages run in child processes, their outputs are published to the store.

mod event;

use std::io;
use std::path::Path;
use std::process::ExitCode;
use std::sync::Arc;
use std::sync::atomic::AtomicBool;
use std::time::Duration;

use dril_stage_api::{Message, Registry};
pub use event::{Event, Outcome};

use crate::plan::Plan;
use crate::resolve::StageIndex;
use crate::store::{Outputs, Store, StoreError};

/// How a plan is executed. None of it changes a result.
#[derive(Clone, Debug)]
pub struct Options {
    /// Threads that stages may keep busy at the same time, at least 1.
    pub threads: usize,
    /// Seconds between checkpoints of a stage.
    pub checkpoint_seconds: f64,
    /// True: after a failure, stages that do not depend on the failed one go on. False: none is started any more.
    pub keep_going: bool,
    /// How long a stage that was asked to stop may take before it is killed.
    pub grace: Duration,
}

impl Default for Options {
    fn default() -> Self {
        let threads = std::thread::available_parallelism().map_or(1, usize::from);
        Self { threads, checkpoint_seconds: 120.0, keep_going: true, grace: Duration::from_secs(20) }
    }
}

/// What a runner is to start.
#[derive(Clone, Copy, Debug)]
pub struct Launch<'a> {
    /// The job file ([`dril_stage_api::Job`] as JSON).
    pub job: &'a Path,
    /// The file for all that the stage prints.
    pub log: &'a Path,
    /// The folder that it may work in; removed afterwards.
    pub folder: &'a Path,
    /// The executable, beside this one, that runs the kind; `None` where this one does.
    pub worker: Option<&'static str>,
    /// Threads that it may keep busy.
    pub threads: usize,
    /// Raised when the stage shall stop: first asked to, then, after `grace`, killed.
    pub stop: &'a AtomicBool,
    /// See [`Options::grace`].
    pub grace: Duration,
}

/// How a stage's process ended.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Exit {
    /// It says that it is done.
    Done,
    /// It was asked to stop, and did.
    Stopped,
    /// It failed, for this reason.
    Failed(String),
}

/// Runs one job, here or elsewhere.
pub trait Runner: Sync {
    /// Says whether it can run the kinds of that worker ([`dril_stage_api::Kind::worker`]); asked before anything runs.
    ///
    /// # Errors
    /// What is missing, and how to mend it.
    fn check(&self, worker: Option<&'static str>) -> Result<(), String> {
        let _ = worker;
        Ok(())
    }

    /// Runs the job to its end; `hear` is told what it says.
    ///
    /// # Errors
    /// It could not be started or watched.
    fn run(&self, launch: &Launch<'_>, hear: &mut dyn FnMut(Message)) -> io::Result<Exit>;
}

/// Runs a job in a child process of its own group: `dril-pipe __stage JOB`, or a worker beside it in the same way.
#[derive(Clone, Debug)]
pub struct ChildRunner {
    /// The program for the kinds that have no worker; workers are looked for in its folder.
    pub program: std::path::PathBuf,
    /// Arguments before the job file.
    pub args: Vec<std::ffi::OsString>,
}

impl ChildRunner {
    /// This program and the workers beside it, as `__stage JOB`.
    ///
    /// # Errors
    /// The system does not say which file this program is.
    pub fn this_program() -> io::Result<Self> {
        Ok(Self { program: std::env::current_exe()?, args: vec!["__stage".into()] })
    }
}

impl Runner for ChildRunner {
    fn run(&self, launch: &Launch<'_>, hear: &mut dyn FnMut(Message)) -> io::Result<Exit> {
        let _ = (launch, hear);
        Ok(Exit::Failed("not there yet".into()))
    }
}

/// What came of a run.
#[derive(Clone, Debug, Default)]
pub struct Executed {
    /// The counts.
    pub outcome: Outcome,
    /// The outputs of every stage that is done, by node index; `None` for the others.
    pub outputs: Vec<Option<Arc<Outputs>>>,
    /// The run's folder with its manifest, events and logs; `None` where nothing had to run.
    pub folder: Option<std::path::PathBuf>,
}

impl Executed {
    /// The outputs of a stage that is done.
    pub fn outputs(&self, stage: StageIndex) -> Option<&Outputs> {
        self.outputs.get(stage.index())?.as_deref()
    }
}

/// Why a run could not go on. A stage that fails is no such error.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum ExecError {
    /// The store cannot be read or written.
    #[error(transparent)]
    Store(#[from] StoreError),
    /// Stages that would run need an executable that is not there.
    #[error("{0}")]
    Worker(String),
}

/// Runs what the plan says, and all that turns out to be stale behind it. Stops cleanly soon after `stop` becomes true.
///
/// # Errors
/// The store cannot be used. Failures of stages are told as events and counted in the outcome.
pub fn execute(
    plan: Plan<'_>,
    store: &Store,
    runner: &dyn Runner,
    options: &Options,
    stop: &AtomicBool,
    sink: &mut dyn FnMut(&Event),
) -> Result<Executed, ExecError> {
    let _ = (plan, store, runner, options, stop, sink);
    Ok(Executed::default())
}

/// The child's side of [`ChildRunner`]: runs the job of a file. Stops at SIGTERM and SIGINT, dies with the engine.
pub fn run_stage(job_file: &Path, registry: &Registry) -> ExitCode {
    let _ = (job_file, registry);
    ExitCode::FAILURE
}
