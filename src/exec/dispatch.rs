//! The dispatcher: the one owner of a run's state. It decides what starts when, and tells; workers work, printers listen.

mod backfill;
mod settle;

use std::collections::{BTreeMap, BTreeSet, HashMap};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc::{Receiver, RecvTimeoutError};
use std::time::{Duration, Instant};

use super::journal::Journal;
use super::ready::{Elsewhere, Ready};
use super::resources::Pool;
use super::work::{News, Site, Task};
use super::{Event, Executed, Kept, Outcome};
use crate::fsx::Lock;
use crate::plan::{self, Cached, Order, OutsideFile, Reason, Verdict};
use crate::resolve::{Graph, StageIndex};
use crate::store::{History, Key, Outputs, Run, StoreError};

/// How soon a wish to stop is noticed.
const GLANCE: Duration = Duration::from_millis(50);

/// Results that may be on their way to the disk at the same time; a slow disk slows the run down here.
const COMMITS: usize = 32;

/// How many of a failed stage's last lines are told.
const TAIL: usize = 20;
/// And how many characters of each.
const TAIL_WIDTH: usize = 300;

/// What the run is about.
#[derive(Clone, Copy)]
pub(super) struct Shape<'a> {
    pub graph: &'a Graph,
    pub files: &'a BTreeMap<String, OutsideFile>,
    pub order: &'a Order,
    /// Stages that run although they are cached.
    pub forced: &'a BTreeSet<StageIndex>,
}

/// Where a stage stands.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum State {
    /// Stages that feed it are not done, or it waits for its turn.
    Pending,
    /// A stage with the same key runs here.
    Twin,
    Running,
    Done,
    /// Failed, skipped or stopped: counted and told.
    Over,
}

/// Starts a worker for a task.
pub(super) type Start<'s, 'a> = dyn FnMut(Task<'a>) + 's;

/// The state of a run.
pub(super) struct Dispatcher<'a, 's> {
    shape: Shape<'a>,
    site: Site<'a>,
    began: Instant,
    history: History,
    /// Held since the plan was made, until the run has noted what it relies on.
    held: Option<Lock>,
    journal: Journal<'a, 's>,
    state: Vec<State>,
    keys: Vec<Option<Key>>,
    why: Vec<Option<Vec<Reason>>>,
    done: Vec<Option<Arc<Outputs>>>,
    /// How many stages that feed it are not done.
    left: Vec<u32>,
    costs: Vec<f64>,
    ready: Ready,
    elsewhere: Elsewhere,
    /// Keys that are being built here, with the other stages that have the same key.
    twins: HashMap<Key, Vec<StageIndex>>,
    /// What was built here and is on its way to the disk: its lock is held until it is there.
    underway: HashMap<Key, Arc<Outputs>>,
    threads_used: usize,
    pool: Pool,
    running: usize,
    /// When each running stage began, for what may slip in before one that has no room.
    pace: backfill::Pace,
    committing: usize,
    stopping: bool,
    /// The failure after which nothing is started any more.
    halted: Option<StageIndex>,
    outcome: Outcome,
}

impl<'a, 's> Dispatcher<'a, 's> {
    pub fn new(
        shape: Shape<'a>,
        (history, held): (History, Option<Lock>),
        site: Site<'a>,
        began: Instant,
        sink: &'s mut dyn FnMut(&Event),
    ) -> Self {
        let count = shape.graph.stages.node_count();
        Self {
            shape,
            site,
            began,
            history,
            held,
            journal: Journal::new(shape.graph, began, sink),
            state: vec![State::Pending; count],
            keys: vec![None; count],
            why: vec![None; count],
            done: vec![None; count],
            left: shape.order.feeders.clone(),
            costs: Vec::new(),
            ready: Ready::default(),
            elsewhere: Elsewhere::default(),
            twins: HashMap::new(),
            underway: HashMap::new(),
            threads_used: 0,
            pool: Pool::new(&site.options.resources),
            running: 0,
            pace: backfill::Pace::default(),
            committing: 0,
            stopping: false,
            halted: None,
            outcome: Outcome::default(),
        }
    }

    /// Runs to the end: until nothing runs and nothing more can start.
    pub fn run(
        &mut self,
        steps: Vec<(StageIndex, Verdict)>,
        news: &Receiver<News>,
        stop: &AtomicBool,
        start: &mut Start<'_, 'a>,
    ) -> Result<(), StoreError> {
        let threads = self.budget();
        self.journal.tell(&Event::Started { stages: steps.len(), threads });
        self.take_over(steps)?;
        loop {
            self.look_at_stop(stop);
            for stage in self.elsewhere.due(Instant::now()) {
                self.ready.push(stage, self.costs[stage.index()]);
            }
            self.start_ready(start)?;
            let waits = !self.elsewhere.is_empty() && !self.stopping && self.halted.is_none();
            if self.running == 0 && self.committing == 0 && !waits {
                return Ok(());
            }
            self.journal.write(false)?;
            match news.recv_timeout(self.patience()) {
                Ok(first) => {
                    for item in std::iter::once(first).chain(news.try_iter()) {
                        self.hear(item)?;
                    }
                }
                Err(RecvTimeoutError::Timeout | RecvTimeoutError::Disconnected) => {}
            }
        }
    }

    /// Counts what never started, writes what is left to write, and gives the result.
    pub fn finish(mut self) -> Result<Executed, StoreError> {
        for index in 0..self.state.len() {
            let stage = StageIndex::new(index);
            match (self.state[index], self.halted) {
                (State::Pending | State::Twin, Some(because)) if !self.stopping => self.skip(stage, because),
                (State::Pending | State::Twin, _) => self.outcome.stopped += 1,
                _ => {}
            }
        }
        // Stopped when all was done already: nothing is left for which there was no time.
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

    /// Takes the plan's verdicts over. What is cached is done at once; the rest becomes ready in turn.
    fn take_over(&mut self, steps: Vec<(StageIndex, Verdict)>) -> Result<(), StoreError> {
        let mut first = Vec::new();
        for (stage, verdict) in steps {
            match verdict {
                Verdict::Cached { key, outputs } => {
                    self.cached(stage, key, outputs)?;
                    for reader in self.shape.order.readers(stage) {
                        self.left[reader.index()] -= 1;
                    }
                }
                Verdict::Run { key, why } => first.push((stage, key, why)),
                Verdict::DependsOn { .. } => {}
            }
        }
        if self.outcome.cached < self.state.len() {
            self.costs = self.shape.order.costs_to_the_end(self.shape.graph);
        }
        for (stage, key, why) in first {
            self.why[stage.index()] = Some(why);
            self.make_ready(stage, key);
        }
        Ok(())
    }

    fn look_at_stop(&mut self, stop: &AtomicBool) {
        let late = self.site.options.deadline.is_some_and(|deadline| Instant::now() >= deadline);
        if !self.stopping && (late || stop.load(Ordering::Relaxed)) {
            self.stopping = true;
            self.outcome.out_of_time = late;
            self.site.halt.store(true, Ordering::Relaxed);
            self.journal.tell(&Event::Stopping { out_of_time: late });
        }
    }

    fn start_ready(&mut self, start: &mut Start<'_, 'a>) -> Result<(), StoreError> {
        while !self.stopping && self.halted.is_none() && self.committing < COMMITS {
            let Some(first) = self.ready.peek() else { break };
            let free = self.budget().saturating_sub(self.threads_used);
            let stage = if !self.pool.has(&self.shape.graph.stages[first].resources) {
                self.pass_by(first, free)
            } else if self.running == 0 || self.threads(first) <= free {
                self.ready.pop()
            } else {
                self.slip_in(first, free)
            };
            let Some(stage) = stage else { break };
            self.start(stage, start)?;
        }
        Ok(())
    }

    /// Starts a stage, unless it was made in the meantime, or is being made here or elsewhere.
    fn start(&mut self, stage: StageIndex, start: &mut Start<'_, 'a>) -> Result<(), StoreError> {
        let Some(key) = self.keys[stage.index()] else { return Ok(()) };
        if let Some(twins) = self.twins.get_mut(&key) {
            twins.push(stage);
            self.state[stage.index()] = State::Twin;
            return Ok(());
        }
        if let Some(outputs) = self.underway.get(&key).map(Arc::clone) {
            return self.settle(stage, key, outputs);
        }
        let run = self.open_run()?;
        let Some(lock) = self.site.store.try_lock(&key)? else {
            if self.elsewhere.note(stage, Instant::now()) {
                self.journal.tell(&Event::Waiting { stage });
            }
            return Ok(());
        };
        self.elsewhere.remove(stage);
        // Under the lock nobody else makes it, but somebody may have, since the plan was made.
        if let Cached::Yes(outputs) = self.look_up(stage, &key)? {
            lock.remove()?;
            return self.settle(stage, key, outputs);
        }
        run.rely_on([key], [])?;
        let why = self.take_why(stage)?;
        self.twins.insert(key, Vec::new());
        self.state[stage.index()] = State::Running;
        self.running += 1;
        self.threads_used += self.threads(stage);
        self.pace.began(stage, self.threads(stage), self.own_cost(stage));
        self.journal.tell(&Event::StageStarted { stage, key, why });
        let units = self.pool.take(stage, &self.shape.graph.stages[stage].resources);
        start(Task::new(stage, key, (lock, units), run, self.shape, &self.done, self.site));
        Ok(())
    }

    /// The run's folder, made when the first stage starts. From then on the run's own note says what it relies on.
    fn open_run(&mut self) -> Result<Arc<Run>, StoreError> {
        if let Some(run) = self.journal.run() {
            return Ok(Arc::clone(run));
        }
        let done = self.shape.graph.stages.node_indices().zip(&self.keys).zip(&self.done);
        let done: Vec<(StageIndex, &Key)> = done
            .filter_map(|((stage, key), done)| Some((stage, key.as_ref().filter(|_| done.is_some())?)))
            .collect();
        let run = self.journal.open(self.site.store, self.site.options, &done)?;
        run.rely_on(done.into_iter().map(|(_, key)| *key), [])?;
        self.held = None;
        Ok(run)
    }

    fn hear(&mut self, news: News) -> Result<(), StoreError> {
        match news {
            News::Said(stage, dril_stage_api::Message::Progress(progress)) => {
                self.journal.tell(&Event::Progressed { stage, progress });
                Ok(())
            }
            News::Said(..) => Ok(()),
            News::Retrying(stage, retry, error, pause) => {
                let of = self.shape.graph.stages[stage].limits.retries;
                self.journal.tell(&Event::Retrying { stage, retry, of, error, pause });
                Ok(())
            }
            News::Built(stage, built) => {
                self.running -= 1;
                self.threads_used -= self.threads(stage);
                self.pace.ended(stage);
                self.pool.give_back(stage);
                let key = self.keys[stage.index()];
                let twins = key.and_then(|key| self.twins.remove(&key)).unwrap_or_default();
                match (built, key) {
                    (Ok(outputs), Some(key)) => self.built(stage, key, outputs, &twins),
                    (Ok(_), None) => Ok(()),
                    (Err(failure), _) => {
                        self.not_built(stage, failure, &twins);
                        Ok(())
                    }
                }
            }
            News::Committed(stage, committed) => self.committed(stage, committed),
        }
    }

    fn make_ready(&mut self, stage: StageIndex, key: Key) {
        self.keys[stage.index()] = Some(key);
        self.ready.push(stage, self.costs[stage.index()]);
    }

    /// Looks whether a key is made; if so, it stays until this run is over.
    fn look_up(&self, stage: StageIndex, key: &Key) -> Result<Cached, StoreError> {
        if self.shape.forced.contains(&stage) {
            return Ok(Cached::No(Some(Reason::Forced)));
        }
        let run = self.journal.run();
        let _held = if run.is_some() { self.site.store.hold()? } else { None };
        let cached = plan::look_up(self.site.store, &self.history, &self.shape.graph.stages[stage], key)?;
        if let (Some(run), Cached::Yes(_)) = (run, &cached) {
            run.rely_on([*key], [])?;
        }
        Ok(cached)
    }

    fn take_why(&mut self, stage: StageIndex) -> Result<Vec<Reason>, StoreError> {
        if let Some(why) = self.why[stage.index()].take() {
            return Ok(why);
        }
        let Shape { graph, files, .. } = self.shape;
        let (store, node) = (self.site.store, &graph.stages[stage]);
        let mut why = plan::why(graph, node, &self.done, files, store, &self.history)?;
        if why.is_empty() {
            why.push(Reason::New);
        }
        Ok(why)
    }

    fn note(&mut self, stage: StageIndex) -> Result<(), StoreError> {
        match (self.keys[stage.index()], &self.done[stage.index()]) {
            (Some(key), Some(outputs)) => self.history.note(&self.shape.graph.stages[stage].id, key, outputs),
            _ => Ok(()),
        }
    }

    fn log_stem(&self, stage: StageIndex) -> String {
        log_stem(self.shape.graph, stage, self.keys[stage.index()].as_ref())
    }

    fn threads(&self, stage: StageIndex) -> usize {
        self.shape.graph.stages[stage].needs.threads.max(1)
    }

    fn budget(&self) -> usize {
        self.site.options.threads.max(1)
    }

    fn patience(&self) -> Duration {
        let next = self.elsewhere.next().map(|next| next.saturating_duration_since(Instant::now()));
        next.map_or(GLANCE, |next| next.min(GLANCE))
    }
}

/// The name of a stage's log: readable, and unique through the key.
pub(super) fn log_stem(graph: &Graph, stage: StageIndex, key: Option<&Key>) -> String {
    let key = key.map(Key::short).unwrap_or_default();
    let stem: String = graph.stages[stage].file_stem().chars().take(40).collect();
    format!("{stem}-{key}")
}
