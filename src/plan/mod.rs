//! From a graph and a store to a plan: every stage's key where it can be known, and what would run, and why.
//! Reads records, runs nothing, writes nothing.

mod cause;
mod estimate;
mod explain;
mod key;
mod lookup;
mod order;
mod outside;

use std::collections::{BTreeMap, BTreeSet, HashMap};
use std::path::Path;
use std::sync::Arc;

pub use cause::{Cause, Explanation, Explanations, explain};
pub use estimate::Estimates;
pub use explain::compare;
pub use key::{NoKey, Work, WorkInput, executable, key_of_record, named};
pub(crate) use lookup::{Cached, digest_of, is_executable, key_of, look_up, record_inputs};
pub use order::Order;
pub(crate) use order::feeding;
pub use outside::{OutsideFile, inside};
use serde::Serialize;

use crate::fsx::{FsError, Lock};
use crate::resolve::{Graph, StageIndex, StageInstance};
use crate::store::{Digest, History, Key, Outputs, Stats, Store, StoreError};

/// What will happen to each stage of a graph.
#[derive(Debug)]
pub struct Plan<'g> {
    /// The pipeline.
    pub graph: &'g Graph,
    /// One verdict a stage, in topological order.
    pub steps: Vec<(StageIndex, Verdict)>,
    /// The files from outside, by path as the pipeline file has it.
    pub files: BTreeMap<String, OutsideFile>,
    pub(crate) order: Order,
    pub(crate) history: History,
    /// Where each stage stands in `steps`.
    position: Vec<usize>,
    /// Keeps what the plan found from being removed, as long as the plan is there.
    pub(crate) held: Option<Lock>,
    /// What was learned about the files from outside, worth keeping.
    pub(crate) stats: Stats,
    /// Stages that run although they are cached.
    pub(crate) forced: BTreeSet<StageIndex>,
}

/// What will happen to a stage.
#[derive(Debug, Clone)]
pub enum Verdict {
    /// Its record and the blobs are there.
    Cached {
        /// The key.
        key: Key,
        /// What was made then.
        outputs: Arc<Outputs>,
    },
    /// It will run, for these reasons.
    Run {
        /// The key.
        key: Key,
        /// Why; never empty.
        why: Vec<Reason>,
    },
    /// Its key is known once these have run (directly or in between); it may still turn out to be cached.
    DependsOn {
        /// The stages with the verdict [`Verdict::Run`] that feed it directly or through others, in node order.
        stages: Arc<[StageIndex]>,
        /// What is known to differ already; empty where nothing is.
        why: Vec<Reason>,
    },
}

/// How many stages have each verdict.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Counts {
    /// Cache hits.
    pub cached: usize,
    /// Stages that will run.
    pub run: usize,
    /// Stages downstream of those.
    pub depends: usize,
}

impl Plan<'_> {
    /// How many stages have each verdict.
    pub fn counts(&self) -> Counts {
        let mut counts = Counts::default();
        for (_, verdict) in &self.steps {
            match verdict {
                Verdict::Cached { .. } => counts.cached += 1,
                Verdict::Run { .. } => counts.run += 1,
                Verdict::DependsOn { .. } => counts.depends += 1,
            }
        }
        counts
    }
}

/// Why no plan could be made.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum PlanError {
    /// Files from outside that cannot be read; all of them.
    #[error("{}", .0.iter().map(ToString::to_string).collect::<Vec<_>>().join("\n"))]
    Files(Vec<MissingFile>),
    /// A stage's parameters have no place in a key.
    #[error("stage `{stage}`: {source}")]
    Params {
        /// The stage.
        stage: String,
        /// Which parameter.
        source: NoKey,
    },
    /// The graph has a cycle, which resolving a pipeline file rules out.
    #[error("stage `{0}` is on a cycle")]
    Cycle(String),
    /// The store cannot be read.
    #[error(transparent)]
    Store(#[from] StoreError),
}

/// A file from outside that cannot be read.
#[derive(Debug, thiserror::Error)]
#[error("{place}: {source}")]
pub struct MissingFile {
    /// Where the pipeline file names it: `thesis.yaml:14:9`.
    pub place: String,
    /// What was tried, on which path, and the system's answer.
    pub source: FsError,
}

/// Why a stage is stale, against the nearest earlier record of the same stage.
#[derive(Debug, Clone, PartialEq, Eq, Serialize)]
#[serde(tag = "because", rename_all = "kebab-case")]
pub enum Reason {
    /// There is no earlier record of this stage.
    New,
    /// It was asked for, whatever is cached.
    Forced,
    /// A parameter has another value; `path` dotted, values as JSON, `None` where absent.
    Param {
        /// Where, as `total_timesteps` or `env.car-racing.time_limit`.
        path: String,
        /// Then.
        old: Option<String>,
        /// Now.
        new: Option<String>,
    },
    /// The seed differs.
    Seed {
        /// Then.
        old: Option<u64>,
        /// Now.
        new: Option<u64>,
    },
    /// The kind was revised: equal inputs give other outputs now.
    Revision {
        /// Then.
        old: u32,
        /// Now.
        new: u32,
    },
    /// The kind itself differs.
    Kind {
        /// Then.
        old: String,
        /// Now.
        new: String,
    },
    /// The content of an input differs.
    Input {
        /// The input's name.
        port: String,
        /// What is wired there: stage and output, or file.
        from: String,
        /// The content then; `None` where nothing stood in its place.
        #[serde(skip_serializing_if = "Option::is_none")]
        old: Option<Digest>,
        /// The content now; `None` where nothing stands in its place, or it is not made yet.
        #[serde(skip_serializing_if = "Option::is_none")]
        new: Option<Digest>,
    },
    /// An input has the same content, but may be executed now, or not any more.
    Rights {
        /// The input's name.
        port: String,
        /// What is wired there: stage and output, or file.
        from: String,
        /// True where it may be executed now.
        executable: bool,
    },
    /// The record is there, but a file that it names is not, or not in full.
    Lost {
        /// The output.
        output: String,
    },
    /// The record is there, but cannot be read.
    Damaged {
        /// What is wrong with it.
        error: String,
    },
}

/// Says what would run, and why. `base` is the folder of the pipeline file, to which its paths are relative.
///
/// # Errors
/// A file from outside or the store cannot be read.
pub fn plan<'g>(graph: &'g Graph, store: &Store, base: &Path) -> Result<Plan<'g>, PlanError> {
    plan_forced(graph, store, base, BTreeSet::new())
}

/// As [`plan`], with stages that are to run although they are cached.
///
/// # Errors
/// As [`plan`].
pub fn plan_forced<'g>(
    graph: &'g Graph,
    store: &Store,
    base: &Path,
    forced: BTreeSet<StageIndex>,
) -> Result<Plan<'g>, PlanError> {
    let (files, stats) = outside::outside_files(graph, base, store)?;
    let order =
        Order::of(graph).map_err(|stage| PlanError::Cycle(graph.stages[stage].id.as_ref().to_owned()))?;
    let held = store.hold()?;
    let history = store.history(&graph.pipeline, &graph.profile)?;
    let there = lookup::latest(graph, store, &history);
    let planner = Planner { graph, store, files: &files, history: &history, there, forced: &forced };
    let steps = planner.steps(&order)?;
    let mut position = vec![0; steps.len()];
    for (at, (index, _)) in steps.iter().enumerate() {
        position[index.index()] = at;
    }
    Ok(Plan { graph, steps, files, order, history, position, held, stats, forced })
}

struct Planner<'a> {
    graph: &'a Graph,
    store: &'a Store,
    files: &'a BTreeMap<String, OutsideFile>,
    history: &'a History,
    /// Results that were found already.
    there: HashMap<Key, Arc<Outputs>>,
    forced: &'a BTreeSet<StageIndex>,
}

impl Planner<'_> {
    fn steps(&self, order: &Order) -> Result<Vec<(StageIndex, Verdict)>, PlanError> {
        let count = self.graph.stages.node_count();
        let mut steps = Vec::with_capacity(count);
        let mut done: Vec<Option<Arc<Outputs>>> = vec![None; count];
        // For each stage that is not cached: the stages that will run and decide about it, itself where it will run.
        let mut roots: Vec<Option<Arc<[StageIndex]>>> = vec![None; count];
        for &index in &order.topological {
            let verdict = self.verdict(index, &done, &roots)?;
            match &verdict {
                Verdict::Cached { outputs, .. } => done[index.index()] = Some(Arc::clone(outputs)),
                Verdict::Run { .. } => roots[index.index()] = Some(Arc::from([index])),
                Verdict::DependsOn { stages, .. } => roots[index.index()] = Some(Arc::clone(stages)),
            }
            steps.push((index, verdict));
        }
        Ok(steps)
    }

    fn verdict(
        &self,
        index: StageIndex,
        done: &[Option<Arc<Outputs>>],
        roots: &[Option<Arc<[StageIndex]>>],
    ) -> Result<Verdict, PlanError> {
        let stage = &self.graph.stages[index];
        let key = key_of(stage, done, self.files)
            .map_err(|source| PlanError::Params { stage: stage.id.as_ref().to_owned(), source })?;
        let Some(key) = key else {
            let feeding = feeding(self.graph, index).filter_map(|from| roots[from.index()].as_ref());
            let why = why(self.graph, stage, done, self.files, self.store, self.history)?;
            return Ok(Verdict::DependsOn { stages: union(feeding), why });
        };
        if self.forced.contains(&index) {
            return Ok(Verdict::Run { key, why: vec![Reason::Forced] });
        }
        if let Some(outputs) = self.there.get(&key) {
            return Ok(Verdict::Cached { key, outputs: Arc::clone(outputs) });
        }
        match look_up(self.store, self.history, stage, &key)? {
            Cached::Yes(outputs) => Ok(Verdict::Cached { key, outputs }),
            Cached::No(Some(reason)) => Ok(Verdict::Run { key, why: vec![reason] }),
            Cached::No(None) => {
                let mut why = why(self.graph, stage, done, self.files, self.store, self.history)?;
                if why.is_empty() {
                    why.push(Reason::New);
                }
                Ok(Verdict::Run { key, why })
            }
        }
    }
}

/// What differs between a stage as it is now and its nearest earlier record, as far as its inputs are known; empty where
/// nothing does.
pub(crate) fn why(
    graph: &Graph,
    stage: &StageInstance,
    done: &[Option<Arc<Outputs>>],
    files: &BTreeMap<String, OutsideFile>,
    store: &Store,
    history: &History,
) -> Result<Vec<Reason>, StoreError> {
    Ok(match lookup::earlier_record(store, history, &stage.id)? {
        Some(record) => explain::differences(graph, stage, &record, done, files),
        None => vec![Reason::New],
    })
}

/// All of these lists in one, sorted; shared where they are all the same, since large graphs have large lists.
fn union<'a>(mut lists: impl Iterator<Item = &'a Arc<[StageIndex]>>) -> Arc<[StageIndex]> {
    let Some(first) = lists.next() else { return Arc::from([]) };
    let mut others = lists.filter(|list| !Arc::ptr_eq(list, first)).peekable();
    if others.peek().is_none() {
        return Arc::clone(first);
    }
    let mut all = first.to_vec();
    let mut seen = first;
    for list in others.filter(|list| !Arc::ptr_eq(list, std::mem::replace(&mut seen, list))) {
        all.extend_from_slice(list);
    }
    all.sort_unstable();
    all.dedup();
    all.into()
}
