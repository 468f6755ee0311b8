//! The steps of a run: load, plan, prepare, execute. Each step is a value that only the step before can make.

use std::collections::BTreeSet;
use std::path::{Path, PathBuf};
use std::sync::OnceLock;
use std::sync::atomic::AtomicBool;
use std::time::Duration;

use super::Session;
use super::about::about;
use super::locking::{Locking, Rewritten};
use super::noticed::Noticed;
use super::results::{self, Published};
use super::source::{PipelineSource, Reading};
use super::unchanged::{self, Known, RunFingerprint};
use crate::error::Error;
use crate::exec::{self, Event, Executed, Options, Runner};
use crate::plan::{self, Estimates, Plan, Verdict, Warning};
use crate::resolve::{Graph, Selected, StageIndex};
use crate::store::{Outputs, Store};

/// A pipeline that was read and resolved.
pub struct Loaded<'s> {
    session: &'s Session<'s>,
    selected: Selected,
    reading: Reading<'s>,
    fingerprint: Option<RunFingerprint>,
    noticed: OnceLock<Noticed>,
}

/// A plan whose preconditions hold: nothing prevents its execution.
pub struct Prepared<'l> {
    loaded: &'l Loaded<'l>,
    plan: Plan<'l>,
    lock: Locking,
    folder: PathBuf,
}

/// A run that came to its end.
#[derive(Debug)]
pub struct Finished {
    /// The counts, keys and outputs.
    pub executed: Executed,
    /// What was copied to the results folder; `None` where there are no results.
    pub published: Option<Published>,
    /// Why the results could not be copied, or what differs from the lock file. The outputs are in the store all the same.
    pub error: Option<Error>,
    /// The lock file, if the run changed it.
    pub locked: Option<Rewritten>,
    /// What is left for the next run, where this one ran out of time.
    pub remaining: Option<Remaining>,
    /// The results folder, even if nothing was copied.
    pub folder: PathBuf,
}

/// What a run that ran out of time leaves to the next one.
#[derive(Clone, Debug)]
pub struct Remaining {
    /// The stages that are not done.
    pub stages: Vec<StageIndex>,
    /// Estimate of the time that they take, from earlier runs; less where some of them have a checkpoint.
    pub time: Duration,
    /// The number of stages without an estimate.
    pub unknown: usize,
    /// The number of threads for which the estimate holds.
    pub threads: usize,
}

impl<'s> Loaded<'s> {
    pub(super) fn new(session: &'s Session<'s>) -> Result<Self, Error> {
        let fingerprint = session.fingerprint();
        let mut reading = Reading::with_memo(&session.store);
        let selected = session.source.select(&session.selection, session.registry, &mut reading)?;
        // Valid only for a file that did not change while it was read.
        let fingerprint = fingerprint.filter(|before| session.fingerprint().as_ref() == Some(before));
        Ok(Self { session, selected, reading, fingerprint, noticed: OnceLock::new() })
    }

    /// The graph of the selected stages.
    pub fn graph(&self) -> &Graph {
        &self.selected.graph
    }

    /// The graph of the whole pipeline.
    pub fn whole_graph(&self) -> &Graph {
        self.selected.all()
    }

    /// The folder of the pipeline file, which relative paths in it start from.
    pub fn base(&self) -> PathBuf {
        self.session.source.base()
    }

    /// What is probably not meant about the selected stages, although they can run.
    pub fn warnings(&self) -> &[Warning] {
        &self.noticed().warnings
    }

    /// The resources that stages of the whole pipeline ask for.
    pub fn resources(&self) -> &BTreeSet<String> {
        &self.noticed().resources
    }

    fn noticed(&self) -> &Noticed {
        self.noticed.get_or_init(|| Noticed::of(self.whole_graph(), self.graph(), &self.base()))
    }

    /// Plans the selected stages. Reads the store and changes nothing.
    ///
    /// # Errors
    /// A file from outside is missing, the store cannot be read, or `--only` excludes a stage that would have to run.
    pub fn plan(&self) -> Result<Plan<'_>, Error> {
        let plan = self.draft()?;
        self.check(&plan)?;
        Ok(plan)
    }

    /// As [`Loaded::plan`], without checking what `--only` excludes: it may still come from elsewhere.
    ///
    /// # Errors
    /// A file from outside is missing, or the store cannot be read.
    pub fn draft(&self) -> Result<Plan<'_>, Error> {
        self.session.source.plan(&self.selected, &self.session.store)
    }

    /// Checks a draft.
    ///
    /// # Errors
    /// `--only` excludes a stage that would have to run.
    pub fn check(&self, plan: &Plan<'_>) -> Result<(), Error> {
        PipelineSource::check_only(&self.selected, plan)
    }

    /// Checks everything that can fail before anything runs: the lock file, the owner of the results folder, and whether both can be
    /// written. Creates nothing.
    ///
    /// # Errors
    /// The plan differs from a lock file that must match, the results folder belongs to another pipeline file, or something that the
    /// run will write cannot be written.
    pub fn prepare<'l>(&'l self, plan: Plan<'l>) -> Result<Prepared<'l>, Error> {
        let session = self.session;
        let lock = Locking::read(&session.source, session.lock)?;
        lock.check_plan(&plan)?;
        let graph = &self.selected.graph;
        let folder = session.out.clone().unwrap_or_else(|| results::default_folder(graph));
        results::check_owner(&folder, &session.source.file, graph)?;
        let counts = plan.counts();
        let will_run = counts.run + counts.depends > 0;
        results::check_place(&folder, graph, will_run)?;
        lock.check_place(will_run)?;
        if let Some(curves) = session.options.curves.as_ref().filter(|_| will_run) {
            results::check_curves(curves)?;
        }
        Ok(Prepared { loaded: self, plan, lock, folder })
    }

    /// What a run that ran out of time leaves to the next one.
    fn remaining(&self) -> Result<Remaining, Error> {
        let (graph, store) = (&self.selected.graph, &self.session.store);
        let plan = plan::plan(graph, store, &self.session.source.base())?;
        let stale = |stage| !matches!(plan.verdict(stage), Some(Verdict::Cached { .. }));
        let threads = self.session.options.threads;
        let (time, unknown) = Estimates::of(&plan, store)?.together(&plan, threads, stale);
        let stages = graph.stages.node_indices().filter(|stage| stale(*stage)).collect();
        Ok(Remaining { stages, time, unknown, threads })
    }
}

impl Prepared<'_> {
    /// The plan.
    pub fn plan(&self) -> &Plan<'_> {
        &self.plan
    }

    /// The results folder.
    pub fn folder(&self) -> &Path {
        &self.folder
    }

    /// Executes the plan, copies the results, and updates the lock file. Stops cleanly soon after `stop` becomes true.
    ///
    /// # Errors
    /// The run could not start or continue. Failed stages are events and are counted in [`Finished::executed`].
    pub fn execute(
        self,
        runner: &dyn Runner,
        stop: &AtomicBool,
        sink: &mut dyn FnMut(&Event),
    ) -> Result<Finished, Error> {
        let Self { loaded, plan, lock, folder } = self;
        let Loaded { session, selected, reading, fingerprint, .. } = loaded;
        let Session { source, store, .. } = session;
        let known = Known { files: unchanged::files_of(&reading.parts, &plan), noticed: loaded.noticed() };
        let options = Options { about: about(session, &reading.texts), ..session.options.clone() };
        let executed = std::thread::scope(|scope| {
            // In parallel: stages take their time anyway, and a run that is cut off has parsed the file, too.
            scope.spawn(|| reading.keep());
            exec::execute(plan, store, runner, &options, stop, sink)
        })?;
        let (published, mut error) = match publish(selected, &folder, &source.file, store, &executed) {
            Ok(published) => (published, None),
            Err(failed) => (None, Some(failed)),
        };
        let mut locked = None;
        if error.is_none() && selected.whole.is_none() {
            match lock.check_or_write(&selected.graph, &executed) {
                Ok(rewritten) => locked = rewritten,
                Err(failed) => error = Some(failed),
            }
        }
        let remaining = if executed.outcome.out_of_time { loaded.remaining().ok() } else { None };
        if let Some(fingerprint) = fingerprint.filter(|_| error.is_none() && executed.outcome.is_complete()) {
            fingerprint.keep(source, &selected.graph, store, known, &executed, published.as_ref());
        }
        Ok(Finished { executed, published, error, locked, remaining, folder })
    }
}

impl Finished {
    /// True where every selected stage is up to date and its results are in place.
    pub fn is_complete(&self) -> bool {
        self.error.is_none() && self.executed.outcome.is_complete()
    }
}

fn publish(
    selected: &Selected,
    folder: &Path,
    file: &Path,
    store: &Store,
    executed: &Executed,
) -> Result<Option<Published>, Error> {
    let outputs = |stage| -> Option<&Outputs> { executed.outputs(selected.place(stage)?) };
    results::publish(folder, file, selected.all(), store, outputs)
}
