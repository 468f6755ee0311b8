//! Runs finished stages a second time, each in a folder of its own, and compares their outputs with the stored ones.

use std::collections::VecDeque;
use std::path::{Path, PathBuf};
use std::sync::atomic::AtomicBool;
use std::sync::mpsc::{Sender, channel};
use std::sync::{Arc, Condvar, Mutex, PoisonError};

use dril_stage_api::{Artifact, Output};
use serde_json::json;

use super::context::RunContext;
use super::executed::ExecError;
use super::failure::Failure;
use super::inputs;
use super::job::{job, outside};
use super::options::Options;
use super::publish::{check_output, import, output_path};
use super::resources::Pool;
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
/// The store cannot be used.
pub fn recheck(
    plan: &Plan<'_>,
    store: &Store,
    runner: &dyn Runner,
    options: &Options,
    stop: &AtomicBool,
    sink: &mut dyn FnMut(StageIndex, &RecheckOutcome),
) -> Result<Vec<(StageIndex, RecheckOutcome)>, ExecError> {
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
    let queue = Mutex::new(queue);
    let threads = Threads::new(context.options.threads.max(1));
    let mut outcomes = Vec::new();
    std::thread::scope(|scope| {
        let (sender, receiver) = channel();
        for _ in 0..context.options.threads.max(1) {
            let sender: Sender<(StageIndex, RecheckOutcome)> = sender.clone();
            let (queue, threads) = (&queue, &threads);
            scope.spawn(move || {
                while let Some((stage, key)) =
                    queue.lock().unwrap_or_else(PoisonError::into_inner).pop_front()
                {
                    let taken = threads.take(context.graph.stages[stage].needs.threads);
                    let outcome = recheck_stage(stage, &key, run, done, context);
                    threads.give_back(taken);
                    if sender.send((stage, outcome)).is_err() {
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
    stage: StageIndex,
    key: &Key,
    run: &Run,
    done: &[Option<Arc<Outputs>>],
    context: RunContext<'_>,
) -> RecheckOutcome {
    let folder = run.temporary().join(key.hex());
    let outcome = run_and_compare(stage, key, run, &folder, done, context);
    let _ = fsx::remove_dir_all(&folder);
    outcome.unwrap_or_else(RecheckOutcome::Failed)
}

fn run_and_compare(
    stage: StageIndex,
    key: &Key,
    run: &Run,
    folder: &Path,
    done: &[Option<Arc<Outputs>>],
    context: RunContext<'_>,
) -> Result<RecheckOutcome, Failure> {
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
    let units = Pool::new(&context.options.resources).take(stage, &node.resources);
    // Checkpoints of its own: what the first run left must not help the second.
    job.checkpoints = folder.join("again").join("files");
    let launch = Launch {
        job: &job,
        kind: node.kind,
        lock: Some(&lock),
        log: &run.log(&context.log_name(stage, Some(key))),
        folder,
        threads: node.needs.threads.max(1),
        units: &units,
        stop: context.halt,
        grace: context.options.grace,
        limits: node.limits,
    };
    if context.runner.run(&launch, &mut |_| {})? == Exit::Stopped {
        return Ok(RecheckOutcome::Stopped);
    }
    for output in &node.ports.outputs {
        let path = output_path(folder, output.name, output.extension);
        check_output(output, &path)?;
        let Some(stored) = outputs.get(output.name) else { continue };
        if let Some(differs) = compare(output, &path, stored, key, run, context.store)? {
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
    key: &Key,
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
    let name = format!("{}-{}.{}", key.short(), output.name, output.extension);
    let kept = run.folder().join("differs").join(name);
    fsx::rename_into(path, &kept)?;
    Ok(Some(RecheckOutcome::Differs { output: output.name.to_owned(), at, path: kept }))
}

/// Threads that stages share.
struct Threads {
    all: usize,
    free: Mutex<usize>,
    changed: Condvar,
}

impl Threads {
    fn new(all: usize) -> Self {
        Self { all, free: Mutex::new(all), changed: Condvar::new() }
    }

    /// Waits until that many are free; a stage that wants more than there are gets all.
    fn take(&self, wanted: usize) -> usize {
        let wanted = wanted.clamp(1, self.all);
        let free = self.free.lock().unwrap_or_else(PoisonError::into_inner);
        let mut free =
            self.changed.wait_while(free, |free| *free < wanted).unwrap_or_else(PoisonError::into_inner);
        *free -= wanted;
        wanted
    }

    fn give_back(&self, taken: usize) {
        *self.free.lock().unwrap_or_else(PoisonError::into_inner) += taken;
        self.changed.notify_all();
    }
}
