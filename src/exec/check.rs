//! Runs finished stages once more, each in a place of its own, and compares what comes out with what is in the store.

use std::collections::VecDeque;
use std::path::PathBuf;
use std::sync::atomic::AtomicBool;
use std::sync::mpsc::{Sender, channel};
use std::sync::{Arc, Condvar, Mutex, PoisonError};

use serde_json::json;

use super::dispatch::{Shape, log_stem};
use super::work::{Site, again};
use super::{ExecError, Options, Runner};
use crate::plan::{Plan, Verdict};
use crate::resolve::StageIndex;
use crate::store::{Fingerprint, Outputs, Store};

/// What came of running a stage once more.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Again {
    /// Every output has the same bytes.
    Same,
    /// An output has other bytes: the first in the order of the kind.
    Differs {
        /// The output.
        output: String,
        /// The first byte that differs, from 0.
        at: u64,
        /// Where the other bytes are.
        path: PathBuf,
    },
    /// It did not come to an end.
    Failed(String),
    /// It was asked to stop.
    Stopped,
}

/// Runs every stage of a plan whose result is there once more and tells what came of it, as it comes. Nothing in the
/// store changes; what differs is kept in the folder of this check.
///
/// # Errors
/// The store cannot be used.
pub fn check(
    plan: &Plan<'_>,
    store: &Store,
    runner: &dyn Runner,
    options: &Options,
    stop: &AtomicBool,
    sink: &mut dyn FnMut(StageIndex, &Again),
) -> Result<Vec<(StageIndex, Again)>, ExecError> {
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
    let shape = Shape { graph: plan.graph, files: &plan.files, order: &plan.order, forced: &plan.forced };
    let site = Site { store, runner, options, halt: stop };
    let queue = Mutex::new(queue);
    let threads = Threads::new(options.threads.max(1));
    let mut told = Vec::new();
    std::thread::scope(|scope| {
        let (sender, receiver) = channel();
        for _ in 0..options.threads.max(1) {
            let sender: Sender<(StageIndex, Again)> = sender.clone();
            let (queue, threads, run, done) = (&queue, &threads, &run, &done);
            scope.spawn(move || {
                while let Some((stage, key)) =
                    queue.lock().unwrap_or_else(PoisonError::into_inner).pop_front()
                {
                    let needs = threads.take(shape.graph.stages[stage].needs.threads);
                    let log = run.log(&log_stem(shape.graph, stage, Some(&key)));
                    let came = again(stage, &key, run, &log, shape, done, site);
                    threads.give_back(needs);
                    if sender.send((stage, came)).is_err() {
                        break;
                    }
                }
            });
        }
        drop(sender);
        for (stage, came) in receiver {
            sink(stage, &came);
            told.push((stage, came));
        }
    });
    if told.iter().all(|(_, came)| *came == Again::Same) {
        crate::fsx::remove_dir_all(run.folder()).map_err(crate::store::StoreError::from)?;
    }
    told.sort_by_key(|(stage, _)| plan.position(*stage));
    Ok(told)
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

    /// Waits until so many are free; a stage that wants more than there are gets all.
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
