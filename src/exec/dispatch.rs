//! The dispatcher: the only owner of a run's state. It decides what starts when and emits all events; workers build stages,
//! reporters listen.

mod backfill;
mod retries;
mod transitions;

use std::collections::HashMap;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc::{Receiver, RecvTimeoutError};
use std::time::{Duration, Instant};

use super::context::RunContext;
use super::event::{Event, RunOutcome};
use super::executed::{Executed, Kept};
use super::journal::Journal;
use super::options::POLL_INTERVAL;
use super::ready::{LockWaits, Ready};
use super::resources::{Pool, Units};
use super::task::{Task, WorkerEvent};
use crate::plan::{self, Cached, Reason, Verdict};
use crate::resolve::StageIndex;
use crate::store::{History, Hold, Key, Outputs, Run, StoreError};

/// Results that may be written to disk at the same time; a slow disk slows the run down here.
const MAX_COMMITS: usize = 32;

/// The last log lines of a failed stage that its event carries.
const TAIL_LINES: usize = 20;
/// Characters of each of these lines.
const TAIL_WIDTH: usize = 300;

/// The state of a stage.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum State {
    /// Stages upstream are not done, or it waits for its turn.
    Pending,
    /// Another stage of this run with the same key is running.
    Twin,
    Running,
    /// It failed, and pauses before its next try.
    Paused,
    Done,
    /// Failed, skipped or stopped: counted and reported.
    Over,
}

/// Hands a task to a worker.
pub(super) type Start<'s, 'a> = dyn FnMut(Task<'a>) + 's;

/// The state of a run.
pub(super) struct Dispatcher<'a, 's> {
    context: RunContext<'a>,
    began: Instant,
    history: History,
    /// The lock against `gc` from the plan, until the run has its own list of what it relies on.
    held: Option<Hold>,
    journal: Journal<'a, 's>,
    state: Vec<State>,
    keys: Vec<Option<Key>>,
    why: Vec<Option<Vec<Reason>>>,
    done: Vec<Option<Arc<Outputs>>>,
    /// For each stage, how many stages that feed it are not done.
    left: Vec<u32>,
    costs: Vec<f64>,
    ready: Ready,
    /// Stages whose key another process is building.
    elsewhere: LockWaits,
    /// Stages that will be tried again.
    paused: Vec<retries::Paused<'a>>,
    /// Keys that are being built by this run, with the other stages that have the same key.
    twins: HashMap<Key, Vec<StageIndex>>,
    /// Outputs that were built by this run and are not durable yet: their locks are held until they are.
    underway: HashMap<Key, Arc<Outputs>>,
    threads_used: usize,
    pool: Pool,
    running: usize,
    /// Start times of running stages, for backfilling.
    pace: backfill::Pace,
    committing: usize,
    stopping: bool,
    /// The failure after which no further stage starts (`--fail-fast`).
    halted: Option<StageIndex>,
    outcome: RunOutcome,
}

impl<'a, 's> Dispatcher<'a, 's> {
    pub fn new(
        context: RunContext<'a>,
        (history, held): (History, Option<Hold>),
        began: Instant,
        sink: &'s mut dyn FnMut(&Event),
    ) -> Self {
        let count = context.graph.stages.node_count();
        Self {
            context,
            began,
            history,
            held,
            journal: Journal::new(context.graph, began, sink),
            state: vec![State::Pending; count],
            keys: vec![None; count],
            why: vec![None; count],
            done: vec![None; count],
            left: context.order.feeders.clone(),
            costs: Vec::new(),
            ready: Ready::default(),
            elsewhere: LockWaits::default(),
            paused: Vec::new(),
            twins: HashMap::new(),
            underway: HashMap::new(),
            threads_used: 0,
            pool: Pool::new(&context.options.resources),
            running: 0,
            pace: backfill::Pace::default(),
            committing: 0,
            stopping: false,
            halted: None,
            outcome: RunOutcome::default(),
        }
    }

    /// Runs to the end: until nothing runs and nothing more can start.
    pub fn run(
        &mut self,
        steps: Vec<(StageIndex, Verdict)>,
        events: &Receiver<WorkerEvent<'a>>,
        stop: &AtomicBool,
        start: &mut Start<'_, 'a>,
    ) -> Result<(), StoreError> {
        let threads = self.budget();
        self.journal.emit(&Event::Started { stages: steps.len(), threads });
        self.apply(steps)?;
        loop {
            self.check_stop(stop);
            for stage in self.elsewhere.due(Instant::now()) {
                self.ready.push(stage, self.costs[stage.index()]);
            }
            self.end_pauses();
            self.start_ready(start)?;
            let waits = !self.elsewhere.is_empty() && !self.stopping && self.halted.is_none();
            if self.running == 0 && self.committing == 0 && self.paused.is_empty() && !waits {
                return Ok(());
            }
            self.journal.write(false)?;
            match events.recv_timeout(self.timeout()) {
                Ok(first) => {
                    for event in std::iter::once(first).chain(events.try_iter()) {
                        self.handle(event)?;
                    }
                }
                Err(RecvTimeoutError::Timeout | RecvTimeoutError::Disconnected) => {}
            }
        }
    }

    /// Counts the stages that never started, writes what is left to write, and returns the result.
    pub fn finish(mut self) -> Result<Executed, StoreError> {
        for index in 0..self.state.len() {
            let stage = StageIndex::new(index);
            match (self.state[index], self.halted) {
                (State::Pending | State::Twin, Some(because)) if !self.stopping => self.skip(stage, because),
                (State::Pending | State::Twin, _) => self.outcome.stopped += 1,
                _ => {}
            }
        }
        // If everything was done when the time was up, the run was not cut short.
        self.outcome.out_of_time &= self.outcome.stopped > 0;
        self.outcome.took = self.began.elapsed();
        let run = self.journal.finish(&self.outcome)?;
        if self.outcome.is_complete() {
            self.history.compact()?
        } else {
            self.history.flush()?
        }
        self.history.touch();
        let folder = run.as_ref().map(|run| run.folder().to_owned());
        let kept = Kept { _run: run, _held: self.held.take().map(Arc::new) };
        Ok(Executed { outcome: self.outcome, outputs: self.done, folder, keys: self.keys, _kept: kept })
    }

    /// Applies the plan's verdicts: cache hits are done at once; the rest becomes ready in turn.
    fn apply(&mut self, steps: Vec<(StageIndex, Verdict)>) -> Result<(), StoreError> {
        let mut first = Vec::new();
        for (stage, verdict) in steps {
            match verdict {
                Verdict::Cached { key, outputs } => {
                    self.cached(stage, key, outputs)?;
                    for reader in self.context.order.readers(stage) {
                        self.left[reader.index()] -= 1;
                    }
                }
                Verdict::Run { key, why } => first.push((stage, key, why)),
                Verdict::DependsOn { .. } => {}
            }
        }
        if self.outcome.cached < self.state.len() {
            self.costs = self.context.order.costs_to_the_end(self.context.graph);
        }
        for (stage, key, why) in first {
            self.why[stage.index()] = Some(why);
            self.make_ready(stage, key);
        }
        Ok(())
    }

    fn check_stop(&mut self, stop: &AtomicBool) {
        let late = self.context.options.deadline.is_some_and(|deadline| Instant::now() >= deadline);
        if !self.stopping && (late || stop.load(Ordering::Relaxed)) {
            self.stopping = true;
            self.outcome.out_of_time = late;
            self.context.halt.store(true, Ordering::Relaxed);
            self.journal.emit(&Event::Stopping { out_of_time: late });
            self.stop_paused();
        }
    }

    fn start_ready(&mut self, start: &mut Start<'_, 'a>) -> Result<(), StoreError> {
        if self.halted.is_some() {
            // Only what has begun continues.
            self.keep_begun();
        }
        while !self.stopping && self.committing < MAX_COMMITS {
            let Some(first) = self.ready.peek() else { break };
            let free = self.budget().saturating_sub(self.threads_used);
            let stage = if !self.pool.has(&self.context.graph.stages[first].resources) {
                self.pass_by(first, free)
            } else if self.running == 0 || self.threads(first) <= free {
                self.ready.pop()
            } else {
                self.backfill(first, free)
            };
            let Some(stage) = stage else { break };
            self.start(stage, start)?;
        }
        Ok(())
    }

    /// Starts a stage, unless its key was built in the meantime or is being built, here or by another process.
    fn start(&mut self, stage: StageIndex, start: &mut Start<'_, 'a>) -> Result<(), StoreError> {
        let Some(key) = self.keys[stage.index()] else { return Ok(()) };
        if let Some(task) = self.take_paused(stage) {
            let units = self.occupy(stage);
            start(task.again(units));
            return Ok(());
        }
        if let Some(twins) = self.twins.get_mut(&key) {
            twins.push(stage);
            self.state[stage.index()] = State::Twin;
            return Ok(());
        }
        if let Some(outputs) = self.underway.get(&key).map(Arc::clone) {
            return self.found(stage, key, outputs);
        }
        let run = self.open_run()?;
        let Some(lock) = self.context.store.try_lock(&key)? else {
            if self.elsewhere.note(stage, Instant::now()) {
                self.journal.emit(&Event::Waiting { stage });
            }
            return Ok(());
        };
        if self.elsewhere.remove(stage) {
            // Another process, perhaps on another machine, has just stored it.
            self.context.store.refresh(&key)?;
        }
        // While we hold the lock no other process builds it, but one may have since the plan was made.
        if let Cached::Yes(outputs) = self.look_up(stage, &key)? {
            lock.remove()?;
            return self.found(stage, key, outputs);
        }
        let why = self.take_why(stage)?;
        self.twins.insert(key, Vec::new());
        self.journal.emit(&Event::StageStarted { stage, key, why });
        let units = self.occupy(stage);
        start(Task::new(stage, key, (lock, units), run, &self.done, self.context));
        Ok(())
    }

    /// The run's folder, created when the first stage starts. From then on the run's own list protects what it relies on.
    fn open_run(&mut self) -> Result<Arc<Run>, StoreError> {
        if let Some(run) = self.journal.run() {
            return Ok(Arc::clone(run));
        }
        let done = self.context.graph.stages.node_indices().zip(&self.keys).zip(&self.done);
        let done: Vec<(StageIndex, &Key)> = done
            .filter_map(|((stage, key), done)| Some((stage, key.as_ref().filter(|_| done.is_some())?)))
            .collect();
        let run = self.journal.open(self.context.store, self.context.options, &done)?;
        run.rely_on(done.into_iter().map(|(_, key)| *key), [])?;
        if !self.context.store.is_undisturbed(self.held.as_ref())? {
            // A `gc` on another machine began while results were looked up that it did not find on a list.
            let _held = self.context.store.hold()?;
            self.check_done()?;
        }
        self.held = None;
        Ok(run)
    }

    /// Checks that the results that were found are still there.
    fn check_done(&self) -> Result<(), StoreError> {
        for (key, outputs) in self.keys.iter().zip(&self.done) {
            if let (Some(key), Some(outputs)) = (key, outputs)
                && (!self.context.store.has_record(key)? || self.context.store.lost(outputs)?.is_some())
            {
                return Err(StoreError::Collected);
            }
        }
        Ok(())
    }

    fn handle(&mut self, event: WorkerEvent<'a>) -> Result<(), StoreError> {
        match event {
            WorkerEvent::Message(stage, dril_stage_api::Message::Progress(progress)) => {
                self.journal.emit(&Event::Progressed { stage, progress });
            }
            WorkerEvent::Message(..) => {}
            WorkerEvent::Retrying { task, retry, failure, pause } => {
                let stage = task.stage();
                let of = self.context.graph.stages[stage].limits.retries;
                let failure = Arc::new(failure);
                self.journal.emit(&Event::Retrying { stage, retry, of, failure, pause });
                self.pause(task, pause);
            }
            WorkerEvent::Built(stage, outputs) => {
                let twins = self.ended(stage);
                if let Some(key) = self.keys[stage.index()] {
                    self.built(stage, key, outputs, &twins)?;
                }
            }
            WorkerEvent::Failed(stage, failure) => {
                let twins = self.ended(stage);
                self.not_built(stage, failure, &twins);
            }
            WorkerEvent::Stopped(stage) => {
                self.ended(stage);
                self.stopped(stage);
            }
            WorkerEvent::TakenOver(stage) => {
                let twins = self.ended(stage);
                if let Some(key) = self.keys[stage.index()] {
                    for stage in std::iter::once(stage).chain(twins) {
                        self.state[stage.index()] = State::Pending;
                        self.make_ready(stage, key);
                    }
                }
            }
            WorkerEvent::Committed(stage, committed) => self.committed(stage, committed)?,
        }
        Ok(())
    }

    /// Gives a stage that starts the threads and units that it asks for.
    fn occupy(&mut self, stage: StageIndex) -> Units {
        self.state[stage.index()] = State::Running;
        self.running += 1;
        self.threads_used += self.threads(stage);
        self.pace.began(stage, self.threads(stage), self.own_cost(stage));
        self.pool.take(stage, &self.context.graph.stages[stage].resources)
    }

    /// Frees what a running stage occupied.
    fn free(&mut self, stage: StageIndex) {
        self.running -= 1;
        self.threads_used -= self.threads(stage);
        self.pace.ended(stage);
        self.pool.give_back(stage);
    }

    /// As [`Self::free`], of a stage that is not tried again. Returns the other stages with its key.
    fn ended(&mut self, stage: StageIndex) -> Vec<StageIndex> {
        self.free(stage);
        self.keys[stage.index()].and_then(|key| self.twins.remove(&key)).unwrap_or_default()
    }

    fn make_ready(&mut self, stage: StageIndex, key: Key) {
        self.keys[stage.index()] = Some(key);
        self.ready.push(stage, self.costs[stage.index()]);
    }

    /// Looks a key up; its result is protected from `gc` until this run is over.
    fn look_up(&self, stage: StageIndex, key: &Key) -> Result<Cached, StoreError> {
        let run = self.journal.run();
        if let Some(run) = run {
            run.rely_on([*key], [])?;
        }
        if self.context.forced.contains(&stage) {
            return Ok(Cached::No(Some(Reason::Forced)));
        }
        let _held = if run.is_some() { self.context.store.hold()? } else { None };
        plan::look_up(self.context.store, &self.history, &self.context.graph.stages[stage], key)
    }

    fn take_why(&mut self, stage: StageIndex) -> Result<Vec<Reason>, StoreError> {
        if let Some(why) = self.why[stage.index()].take() {
            return Ok(why);
        }
        let RunContext { graph, files, store, .. } = self.context;
        let node = &graph.stages[stage];
        let mut why = plan::why(graph, node, &self.done, files, store, &self.history)?;
        if why.is_empty() {
            why.push(Reason::New);
        }
        Ok(why)
    }

    /// Adds a finished stage to the history that the next run starts from.
    fn record_in_history(&mut self, stage: StageIndex) -> Result<(), StoreError> {
        match (self.keys[stage.index()], &self.done[stage.index()]) {
            (Some(key), Some(outputs)) => {
                self.history.note(&self.context.graph.stages[stage].id, key, outputs)
            }
            _ => Ok(()),
        }
    }

    fn log_name(&self, stage: StageIndex) -> String {
        self.context.log_name(stage, self.keys[stage.index()].as_ref())
    }

    fn threads(&self, stage: StageIndex) -> usize {
        self.context.graph.stages[stage].needs.threads.max(1)
    }

    fn budget(&self) -> usize {
        self.context.options.threads.max(1)
    }

    /// How long to wait for the next event.
    fn timeout(&self) -> Duration {
        let next = self.elsewhere.next().into_iter().chain(self.next_try()).min();
        let next = next.map(|next| next.saturating_duration_since(Instant::now()));
        next.map_or(POLL_INTERVAL, |next| next.min(POLL_INTERVAL))
    }
}
