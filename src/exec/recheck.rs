//! Runs finished stages a second time, each in a folder of its own, and compares their outputs with the stored ones.

use std::collections::{HashSet, VecDeque};
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc::{Sender, channel};
use std::sync::{Arc, Condvar, Mutex, PoisonError};

use dril_stage_api::{Artifact, Output};
use serde_json::json;

use super::context::RunContext;
use super::execute::check_resources;
use super::executed::ExecError;
use super::failure::Failure;
use super::inputs;
use super::job::{job, outside};
use super::options::Options;
use super::publish::{check_output, import, output_path};
use super::resources::{Pool, Units};
use super::runner::{Exit, Launch, Runner};
use crate::fsx::{self, Lock};
use crate::plan::{Plan, Verdict};
use crate::resolve::StageIndex;
use crate::store::{self, Fingerprint, Key, Outputs, Run, Store, StoreError, Stored};

/// The outcome of running a stage a second time.
#[derive(Debug)]
pub enum RecheckOutcome {
    /// Every output has the same bytes.
    Same,
    /// An output differs: the first one, in the order of the kind.
    Differs {
        /// The output.
        output: String,
        /// The first byte that differs, from 0.
        at: u64,
        /// Where the new bytes are kept.
        path: PathBuf,
    },
    /// The second run failed.
    Failed(Failure),
    /// It was asked to stop.
    Stopped,
}

impl RecheckOutcome {
    /// True where every output has the same bytes.
    pub fn is_same(&self) -> bool {
        matches!(self, Self::Same)
    }
}

/// Runs every cached stage of a plan a second time and reports each outcome as it comes. The store's results do not change;
/// outputs that differ are kept in this check's run folder.
///
/// # Errors
/// The store cannot be used, or a stage asks for more of a resource than there is.
pub fn recheck(
    plan: &Plan<'_>,
    store: &Store,
    runner: &dyn Runner,
    options: &Options,
    stop: &AtomicBool,
    sink: &mut dyn FnMut(StageIndex, &RecheckOutcome),
) -> Result<Vec<(StageIndex, RecheckOutcome)>, ExecError> {
    check_resources(plan.graph, plan.steps.iter().map(|(stage, _)| *stage), &options.resources)?;
    let run = Arc::new(store.begin_run(&json!({
        "version": 1, "pipeline": plan.graph.pipeline, "profile": plan.graph.profile, "check": true,
        "fingerprint": Fingerprint::current(),
    }))?);
    let mut done: Vec<Option<Arc<Outputs>>> = vec![None; plan.graph.stages.node_count()];
    let mut queue = VecDeque::new();
    for (index, verdict) in &plan.steps {
        if let Verdict::Cached { key, outputs } = verdict {
            done[index.index()] = Some(Arc::clone(outputs));
            queue.push_back((*index, *key));
        }
    }
    run.rely_on(queue.iter().map(|(_, key)| *key), [])?;
    let context = RunContext {
        graph: plan.graph,
        files: &plan.files,
        order: &plan.order,
        forced: &plan.forced,
        store,
        runner,
        options,
        halt: stop,
    };
    let mut outcomes = recheck_all(queue, &run, &done, context, sink);
    if outcomes.iter().all(|(_, outcome)| outcome.is_same()) {
        fsx::remove_dir_all(run.folder()).map_err(StoreError::from)?;
    }
    outcomes.sort_by_key(|(stage, _)| plan.position(*stage));
    Ok(outcomes)
}

/// Works through the queue on as many threads as the options allow.
fn recheck_all(
    queue: VecDeque<(StageIndex, Key)>,
    run: &Run,
    done: &[Option<Arc<Outputs>>],
    context: RunContext<'_>,
    sink: &mut dyn FnMut(StageIndex, &RecheckOutcome),
) -> Vec<(StageIndex, RecheckOutcome)> {
    let queue = Queue::new(queue, context);
    let mut outcomes = Vec::new();
    std::thread::scope(|scope| {
        let (sender, receiver) = channel();
        for _ in 0..queue.threads {
            let sender: Sender<(StageIndex, RecheckOutcome)> = sender.clone();
            let queue = &queue;
            scope.spawn(move || {
                while let Some(turn) = queue.next() {
                    let outcome = recheck_stage(&turn, run, done, context);
                    queue.give_back(&turn);
                    if sender.send((turn.stage, outcome)).is_err() {
                        break;
                    }
                }
            });
        }
        drop(sender);
        for (stage, outcome) in receiver {
            sink(stage, &outcome);
            outcomes.push((stage, outcome));
        }
    });
    outcomes
}

fn recheck_stage(
    turn: &Turn,
    run: &Run,
    done: &[Option<Arc<Outputs>>],
    context: RunContext<'_>,
) -> RecheckOutcome {
    if context.halt.load(Ordering::Relaxed) {
        return RecheckOutcome::Stopped;
    }
    let folder = run.temporary().join(turn.key.hex());
    let outcome = run_and_compare(turn, run, &folder, done, context);
    let _ = fsx::remove_dir_all(&folder);
    outcome.unwrap_or_else(RecheckOutcome::Failed)
}

fn run_and_compare(
    Turn { stage, key, units }: &Turn,
    run: &Run,
    folder: &Path,
    done: &[Option<Arc<Outputs>>],
    context: RunContext<'_>,
) -> Result<RecheckOutcome, Failure> {
    let stage = *stage;
    let node = &context.graph.stages[stage];
    let Some(outputs) = &done[stage.index()] else { return Ok(RecheckOutcome::Same) };
    if node.ports.outside.is_some() {
        return Ok(RecheckOutcome::Same);
    }
    for file in outside(node, context) {
        import(file, context.store, run)?;
    }
    fsx::create_dir(folder)?;
    let (mut job, placed) = job(node, key, folder, done, context);
    inputs::lay_out(&placed, context.store)?;
    let lock = Lock::acquire(&folder.join("lock"))?;
    // Checkpoints of its own: what the first run left must not help the second.
    job.checkpoints = folder.join("again").join("files");
    let launch = Launch {
        job: &job,
        kind: node.kind,
        lock: Some(&lock),
        log: &run.log(&context.log_name(stage, Some(key))),
        folder,
        threads: node.needs.threads.max(1),
        units,
        stop: context.halt,
        grace: context.options.grace,
        limits: node.limits,
        fresh: false,
        inputs: None,
    };
    if context.runner.run(&launch, &mut |_| {})? == Exit::Stopped {
        return Ok(RecheckOutcome::Stopped);
    }
    for output in &node.ports.outputs {
        let path = output_path(folder, output.name, output.extension);
        check_output(output, &path)?;
        let Some(stored) = outputs.get(output.name) else { continue };
        if let Some(differs) = compare(output, &path, stored, (stage, key), run, context.store)? {
            return Ok(differs);
        }
    }
    Ok(RecheckOutcome::Same)
}

/// Compares one output with the stored one. Where it differs, it is kept in the run's folder.
fn compare(
    output: &Output,
    path: &Path,
    stored: &Stored,
    (stage, key): (StageIndex, &Key),
    run: &Run,
    store: &Store,
) -> Result<Option<RecheckOutcome>, Failure> {
    let digest = match output.artifact {
        Artifact::FOLDER => store::hash_folder(path)?.digest(),
        _ => store::hash_file(path)?.0,
    };
    if digest == stored.digest {
        return Ok(None);
    }
    let at = if stored.folder { 0 } else { fsx::first_difference(path, &store.blob_path(&stored.digest))? };
    let name = format!("{}-{}-{}.{}", key.short(), stage.index(), output.name, output.extension);
    let kept = run.folder().join("differs").join(name);
    fsx::rename_into(path, &kept)?;
    Ok(Some(RecheckOutcome::Differs { output: output.name.to_owned(), at, path: kept }))
}

/// The stages that are left, and the threads and units that are free.
struct Queue<'a> {
    context: RunContext<'a>,
    threads: usize,
    state: Mutex<State>,
    changed: Condvar,
}

struct State {
    left: VecDeque<(StageIndex, Key)>,
    /// Of the stages that run: those with the same key use the same folder, one after the other.
    keys: HashSet<Key>,
    threads: usize,
    pool: Pool,
}

/// A stage whose turn it is, with what it may use.
struct Turn {
    stage: StageIndex,
    key: Key,
    units: Units,
}

impl<'a> Queue<'a> {
    fn new(left: VecDeque<(StageIndex, Key)>, context: RunContext<'a>) -> Self {
        let threads = context.options.threads.max(1);
        let state =
            State { left, keys: HashSet::new(), threads, pool: Pool::new(&context.options.resources) };
        Self { context, threads, state: Mutex::new(state), changed: Condvar::new() }
    }

    /// The threads of a stage; one that wants more than there are gets all.
    fn wanted(&self, stage: StageIndex) -> usize {
        self.context.graph.stages[stage].needs.threads.clamp(1, self.threads)
    }

    /// Waits for the next stage that can run; `None` where none is left.
    fn next(&self) -> Option<Turn> {
        let mut state = self.state.lock().unwrap_or_else(PoisonError::into_inner);
        loop {
            if state.left.is_empty() {
                return None;
            }
            let fits = |(stage, key): &(StageIndex, Key)| {
                self.wanted(*stage) <= state.threads
                    && !state.keys.contains(key)
                    && state.pool.has(&self.context.graph.stages[*stage].resources)
            };
            if let Some(at) = state.left.iter().position(fits) {
                let (stage, key) = state.left.remove(at)?;
                state.keys.insert(key);
                state.threads -= self.wanted(stage);
                let units = state.pool.take(stage, &self.context.graph.stages[stage].resources);
                return Some(Turn { stage, key, units });
            }
            // No stage wants more than there is in all, so the next one can run at the latest when no other one does.
            state = self.changed.wait(state).unwrap_or_else(PoisonError::into_inner);
        }
    }

    fn give_back(&self, turn: &Turn) {
        let mut state = self.state.lock().unwrap_or_else(PoisonError::into_inner);
        state.keys.remove(&turn.key);
        state.threads += self.wanted(turn.stage);
        state.pool.give_back(turn.stage);
        self.changed.notify_all();
    }
}
