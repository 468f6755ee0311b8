//! One stage from its job to its record: what a worker thread does while the dispatcher continues.

use std::panic::{AssertUnwindSafe, catch_unwind};
use std::path::PathBuf;
use std::sync::Arc;
use std::sync::atomic::Ordering;
use std::sync::mpsc::{SendError, SyncSender};
use std::time::{Duration, Instant, SystemTime};

use dril_stage_api::{Job, Kind, Message, Ports};

use super::checkpoints;
use super::context::RunContext;
use super::failure::{Failure, FailureKind};
use super::inputs::{self, Placed};
use super::job::{job, outside, record};
use super::origins::name_inputs;
use super::publish;
use super::resources::Units;
use super::runner::{Exit, Launch};
use crate::fsx::{self, Lock};
use crate::plan::OutsideFile;
use crate::resolve::StageIndex;
use crate::spec::Limits;
use crate::store::{Blob, Key, Outputs, Record, Run, StoreError};

/// A stage that is about to run, with the exclusive right to write its record.
pub(super) struct Task<'a> {
    stage: StageIndex,
    key: Key,
    lock: Lock,
    /// The units of counted resources that it holds.
    units: Units,
    /// How often it was tried again.
    retries: u32,
    run: Arc<Run>,
    job: Job,
    ports: &'a Ports,
    kind: Kind,
    threads: usize,
    limits: Limits,
    /// Files from outside that it reads.
    files: Vec<&'a OutsideFile>,
    /// Inputs that are laid out in its private folder.
    placed: Vec<Placed>,
    /// Size and time of the record that was there when the lock was taken.
    before: Option<(u64, i128)>,
    /// Complete but for what is known only afterwards: outputs and duration.
    record: Record,
    /// Its private folder, which does not exist yet.
    folder: PathBuf,
    log: PathBuf,
}

/// Events that a worker sends to the dispatcher.
pub(super) enum WorkerEvent<'a> {
    /// A message of the stage.
    Message(StageIndex, Message),
    /// The stage ended with success, and its outputs can be read: stages that wait for them can start. A crash before
    /// [`WorkerEvent::Committed`] means only that it runs again, since keys go by content.
    Built(StageIndex, Arc<Outputs>),
    /// It was asked to stop, and did.
    Stopped(StageIndex),
    /// It failed.
    Failed(StageIndex, Failure),
    /// This process stood still for so long that another machine has the work now: it waits for that result.
    TakenOver(StageIndex),
    /// It failed and is to be tried again after a pause: [`Task::again`].
    Retrying {
        task: Box<Task<'a>>,
        /// The number of the next try, from 1.
        retry: u32,
        failure: Failure,
        pause: Duration,
    },
    /// After `Built`: the record is durable (with the time that the stage took), or could not be written.
    Committed(StageIndex, Result<Duration, StoreError>),
}

/// What came of trying to build a stage, where it did not fail.
enum Attempt {
    Built { blobs: Vec<Blob>, took: Duration },
    Stopped,
}

impl<'a> Task<'a> {
    /// Prepares a stage whose inputs are all built.
    pub fn new(
        stage: StageIndex,
        key: Key,
        (lock, units): (Lock, Units),
        run: Arc<Run>,
        done: &[Option<Arc<Outputs>>],
        context: RunContext<'a>,
    ) -> Self {
        let node = &context.graph.stages[stage];
        let folder = run.temporary().join(key.hex());
        let (job, placed) = job(node, &key, &folder, done, context);
        Self {
            log: run.log(&context.log_name(stage, Some(&key))),
            job,
            placed,
            before: fsx::stamp(&context.store.record_path(&key)),
            record: record(node, done, context),
            ports: &node.ports,
            kind: node.kind,
            threads: node.needs.threads.max(1),
            limits: node.limits,
            files: outside(node, context).collect(),
            stage,
            key,
            lock,
            units,
            retries: 0,
            run,
            folder,
        }
    }

    /// Builds the stage, publishes its outputs, and reports every step. The dispatcher may be gone by then, so failed sends
    /// are ignored.
    pub fn work(mut self, context: RunContext<'_>, events: &SyncSender<WorkerEvent<'a>>) {
        let stage = self.stage;
        let send = |event| drop(events.send(event));
        // A panic in a runner must not leave the dispatcher waiting forever.
        let built = catch_unwind(AssertUnwindSafe(|| self.build(context, &send)));
        let built = match built {
            Ok(Err(failure)) if self.may_retry(&failure) => {
                if !context.halt.load(Ordering::Relaxed) {
                    return self.try_again(failure, events);
                }
                Ok(Attempt::Stopped)
            }
            built => built.unwrap_or(Err(Failure::Panicked)),
        };
        // Where that cannot be found out, the store cannot be written either.
        let taken_over = !self.lock.is_ours().unwrap_or(true);
        match built {
            Ok(Attempt::Built { .. }) | Err(_) if taken_over => send(WorkerEvent::TakenOver(stage)),
            Err(failure) => send(WorkerEvent::Failed(stage, failure)),
            Ok(Attempt::Stopped) => send(WorkerEvent::Stopped(stage)),
            Ok(Attempt::Built { blobs, took }) => {
                send(WorkerEvent::Built(stage, Arc::new(self.record.outputs.clone())));
                let committed = self.commit(context, &blobs);
                send(WorkerEvent::Committed(stage, committed.map(|()| took)));
            }
        }
        self.give_up();
    }

    /// Removes its folder and releases its key.
    pub fn give_up(self) {
        self.run.clear(&self.folder);
        let _ = self.lock.remove();
    }

    pub fn stage(&self) -> StageIndex {
        self.stage
    }

    /// The same task, for its next try with these units of counted resources.
    pub fn again(self, units: Units) -> Self {
        Self { units, ..self }
    }

    /// True where its `retries` allow another try. A problem of the store is not retried: it would not go away.
    fn may_retry(&self, failure: &Failure) -> bool {
        failure.kind() != FailureKind::Store && self.retries < self.limits.retries
    }

    /// Hands itself to the dispatcher: during the pause, other stages use its threads and units. It keeps its key.
    fn try_again(mut self, failure: Failure, events: &SyncSender<WorkerEvent<'a>>) {
        self.retries += 1;
        let (retry, pause) = (self.retries, self.limits.pause_before(self.retries));
        let unsent = events.send(WorkerEvent::Retrying { task: Box::new(self), retry, failure, pause });
        if let Err(SendError(WorkerEvent::Retrying { task, .. })) = unsent {
            task.give_up();
        }
    }

    fn build(&mut self, context: RunContext<'_>, send: &dyn Fn(WorkerEvent<'a>)) -> Result<Attempt, Failure> {
        for file in &self.files {
            let inside = file.folder.iter().flat_map(|folder| folder.files().map(|(_, file)| file.digest));
            self.run.rely_on([], inside.chain([file.digest]))?;
            let _held = context.store.hold()?;
            publish::import(file, context.store, &self.run)?;
        }
        // An earlier stage of this run with the same key may have left it (two stages that were forced).
        fsx::remove_dir_all(&self.folder)?;
        fsx::create_dir(&self.folder)?;
        if self.ports.outside.is_some() {
            self.record.outputs = publish::outside_as_outputs(&self.files, self.ports);
            return Ok(Attempt::Built { blobs: Vec::new(), took: Duration::ZERO });
        }
        let laid_out = inputs::lay_out(&self.placed, context.store)?;
        // What a forced stage saves before it is tried again is its own.
        let fresh = context.forced.contains(&self.stage) && self.retries == 0;
        let saved = if fresh { None } else { checkpoints::saved(&self.job)? };
        let launch = Launch {
            job: &self.job,
            kind: self.kind,
            lock: Some(&self.lock),
            log: &self.log,
            folder: &self.folder,
            threads: self.threads,
            units: &self.units,
            stop: context.halt,
            grace: context.options.grace,
            limits: self.limits,
            fresh,
            inputs: Some(&laid_out),
        };
        let before = saved.map_or(Duration::ZERO, |_| checkpoints::spent(&self.job));
        let (began, began_at) = (Instant::now(), SystemTime::now());
        let (stage, made_with) = (self.stage, &mut self.record.fingerprint.with);
        let mut on_message = |message| match message {
            Message::MadeWith(versions) => made_with.extend(versions),
            other => send(WorkerEvent::Message(stage, other)),
        };
        let exit = context.runner.run(&launch, &mut on_message);
        if !matches!(exit, Ok(Exit::Done)) {
            checkpoints::note_spent(&self.job, before, began_at);
        }
        let mention = |failure| checkpoints::mention(failure, &self.job.stage, saved);
        let name = |failure| mention(name_inputs(failure, &self.job, &self.record));
        if exit.map_err(name)? == Exit::Stopped {
            return Ok(Attempt::Stopped);
        }
        let took = began.elapsed();
        laid_out.check()?;
        self.record.seconds = (before + took).as_secs_f64();
        let taken = publish::take_outputs(self.ports, &self.folder, context.store, &self.run);
        let (outputs, blobs) = taken.map_err(mention)?;
        self.record.outputs = outputs;
        Ok(Attempt::Built { blobs, took })
    }

    /// Makes the result durable, unless somebody else was first: a process that stood still just after it had checked its lock.
    fn commit(&self, context: RunContext<'_>, blobs: &[Blob]) -> Result<(), StoreError> {
        if fsx::stamp(&context.store.record_path(&self.key)) != self.before
            && let Some(first) = context.store.record(&self.key)?
            && let Some(output) = first.differing_output(&self.record)
        {
            return Err(StoreError::Differs(output.to_owned()));
        }
        publish::commit(context.store, &self.key, &self.record, blobs, &self.folder)
    }
}
