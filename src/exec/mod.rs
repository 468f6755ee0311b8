//! Runs a plan: one dispatcher owns the state, stages run in child processes, their outputs are published to the store.

mod check;
mod child;
mod dispatch;
mod event;
mod in_order;
mod inline;
mod inputs;
mod job;
mod journal;
mod listen;
mod memory;
mod processes;
mod ready;
mod resources;
mod runner;
mod stage;
mod survivors;
mod unstarted;
mod warden;
mod work;
mod workers;

use std::path::PathBuf;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc;
use std::time::{Duration, Instant};

pub use check::{Again, check};
pub use child::ChildRunner;
pub use event::{Cause, Event, Outcome};
pub use inline::InlineRunner;
pub use resources::{TooFew, Units};
pub use runner::{Exit, Launch, Runner};
pub use stage::{EXIT_STOPPED, run_stage};
pub use survivors::claim_all_children;
pub use warden::{WARDEN, watch_over};

use crate::fsx::Lock;
use crate::plan::{Plan, Verdict};
use crate::resolve::StageIndex;
use crate::store::{Key, Outputs, Run, Store, StoreError};
use workers::Workers;

/// How a plan is executed. None of it changes a result.
#[derive(Clone, Debug)]
pub struct Options {
    /// Threads that stages may keep busy at the same time, at least 1.
    pub threads: usize,
    /// Seconds between checkpoints of a stage.
    pub checkpoint_seconds: f64,
    /// An absolute folder in which stages that learn write their curves, each in a folder of its own; none: nowhere.
    pub curves: Option<PathBuf>,
    /// True: after a failure, stages that do not depend on the failed one go on. False: none is started any more.
    pub keep_going: bool,
    /// How long a stage that was asked to stop may take before it is killed.
    pub grace: Duration,
    /// When to stop, as if somebody had asked.
    pub deadline: Option<Instant>,
    /// The units of counted resources; of one that is not among them there is one.
    pub resources: Units,
    /// What the run's folder notes of where the plan comes from: fields for its manifest.
    pub about: serde_json::Map<String, serde_json::Value>,
}

impl Default for Options {
    fn default() -> Self {
        let threads = std::thread::available_parallelism().map_or(1, usize::from);
        Self {
            threads,
            checkpoint_seconds: 120.0,
            curves: None,
            keep_going: true,
            grace: Duration::from_secs(20),
            deadline: None,
            resources: Units::new(),
            about: serde_json::Map::new(),
        }
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
    pub folder: Option<PathBuf>,
    /// The key of each stage that is done, by node index.
    pub keys: Vec<Option<Key>>,
    /// Keeps the outputs from being removed as long as this is there.
    pub(crate) _kept: Kept,
}

/// What keeps the outputs of a run from being removed: its note of what it relies on, or (where nothing ran) the lock.
#[derive(Clone, Debug, Default)]
pub(crate) struct Kept {
    _run: Option<Arc<Run>>,
    _held: Option<Arc<Lock>>,
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
    #[error("stages of kind `{kind}` cannot run: {message}")]
    Worker {
        /// The first kind of them.
        kind: &'static str,
        /// What is missing.
        message: String,
    },
    /// A stage that would run asks for more of a resource than there is.
    #[error(transparent)]
    TooFew(#[from] TooFew),
}

/// Runs what the plan says, and all that turns out to be stale behind it. Stops cleanly soon after `stop` becomes true.
///
/// # Errors
/// The store cannot be used, or an executable is missing. Failures of stages are told as events and counted in the
/// outcome.
pub fn execute(
    plan: Plan<'_>,
    store: &Store,
    runner: &dyn Runner,
    options: &Options,
    stop: &AtomicBool,
    sink: &mut dyn FnMut(&Event),
) -> Result<Executed, ExecError> {
    let began = Instant::now();
    check_workers(&plan, runner)?;
    check_resources(&plan, &options.resources)?;
    let Plan { graph, steps, files, order, history, held, stats, forced, .. } = plan;
    // It saves time the next time; a store that cannot be written is told where it matters.
    let _ = store.keep_stats(&stats);
    let halt = AtomicBool::new(false);
    let site = work::Site { store, runner, options, halt: &halt };
    let shape = dispatch::Shape { graph, files: &files, order: &order, forced: &forced };
    let mut dispatcher = dispatch::Dispatcher::new(shape, (history, held), site, began, sink);
    std::thread::scope(|scope| {
        let (sender, receiver) = mpsc::sync_channel(256);
        let workers = Workers::new(scope, move |task: work::Task<'_>| task.work(site, &sender));
        let result = dispatcher.run(steps, &receiver, stop, &mut |task| workers.start(task));
        // Where the dispatcher gave up, running stages are not to go on, and nobody listens to them any more.
        halt.store(true, Ordering::Relaxed);
        result
    })?;
    Ok(dispatcher.finish()?)
}

/// Finds out before anything runs that a stage can never start.
fn check_resources(plan: &Plan<'_>, units: &Units) -> Result<(), TooFew> {
    for (stage, verdict) in &plan.steps {
        let node = &plan.graph.stages[*stage];
        if matches!(verdict, Verdict::Cached { .. }) {
            continue;
        }
        for (name, wanted) in node.resources.iter() {
            let there = resources::Pool::count(units, name);
            if *wanted as usize > there {
                return Err(TooFew {
                    stage: node.id.to_string(),
                    name: name.clone(),
                    wanted: *wanted,
                    there,
                });
            }
        }
    }
    Ok(())
}

/// Finds out before anything runs, and not after hours, that an executable is missing.
fn check_workers(plan: &Plan<'_>, runner: &dyn Runner) -> Result<(), ExecError> {
    let mut checked: Vec<Option<&'static str>> = Vec::new();
    for (stage, verdict) in &plan.steps {
        let kind = &plan.graph.stages[*stage].kind;
        if !matches!(verdict, Verdict::Cached { .. }) && !checked.contains(&kind.worker()) {
            runner
                .check(kind.worker())
                .map_err(|message| ExecError::Worker { kind: kind.name(), message })?;
            checked.push(kind.worker());
        }
    }
    Ok(())
}
