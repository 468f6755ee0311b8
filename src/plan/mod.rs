//! From a graph and a store to a plan: the key of every stage where it can be known, what would run, and why. Reads records; runs
//! and writes nothing.

mod compare;
mod estimate;
mod explain;
mod forecast;
mod idle;
mod key;
mod lookup;
mod order;
mod outside;
mod pooled;
mod undeclared;
mod warning;
mod warnings;

use std::collections::{BTreeMap, BTreeSet, HashMap};
use std::path::Path;
use std::sync::Arc;

pub use compare::compare;
pub use estimate::Estimates;
pub use explain::{Cause, Explanation, Explanations, explain};
pub use forecast::{Forecast, Place};
pub use key::{KeyInput, KeyInputs, NoKey, executable, key_of_record, named};
pub(crate) use lookup::{Cached, digest_of, is_executable, key_of, look_up, record_inputs};
pub use order::Order;
pub(crate) use order::feeding;
pub use outside::{OutsideFile, inside};
use serde::Serialize;
pub(crate) use undeclared::{is_file, named_files};
pub use warning::Warning;
pub use warnings::warnings;

use crate::fsx::FsError;
use crate::resolve::{Graph, StageIndex, StageInstance};
use crate::store::{Digest, History, Hold, Key, Outputs, Stats, Store, StoreError};

/// What will happen to each stage of a graph.
#[derive(Debug)]
pub struct Plan<'g> {
    /// The pipeline.
    pub graph: &'g Graph,
    /// One verdict per stage, in topological order.
    pub steps: Vec<(StageIndex, Verdict)>,
    /// Files from outside, by their paths in the pipeline file.
    pub files: BTreeMap<String, OutsideFile>,
    pub(crate) order: Order,
    pub(crate) history: History,
    /// The index of each stage in `steps`.
    position: Vec<usize>,
    /// Protects what the plan found from `gc` while the plan exists.
    pub(crate) held: Option<Hold>,
    /// Digests of files from outside, to be cached.
    pub(crate) stats: Stats,
    /// Stages that run even if they are cached.
    pub(crate) forced: BTreeSet<StageIndex>,
}

/// What will happen to a stage.
#[derive(Debug, Clone)]
pub enum Verdict {
    /// Cache hit: its record and blobs exist.
    Cached {
        /// The key.
        key: Key,
        /// Its outputs.
        outputs: Arc<Outputs>,
    },
    /// It will run, for these reasons.
    Run {
        /// The key.
        key: Key,
        /// Why; never empty.
        why: Vec<Reason>,
    },
    /// Its key is known once upstream stages have run; it may still turn out to be cached.
    DependsOn {
        /// The upstream stages with the verdict [`Verdict::Run`], in node order.
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
    /// A stage's parameters cannot enter a key.
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

/// Why a stage is stale, compared with its nearest earlier record.
#[derive(Debug, Clone, PartialEq, Eq, Serialize)]
#[serde(tag = "because", rename_all = "kebab-case")]
pub enum Reason {
    /// There is no earlier record of this stage.
    New,
    /// It was forced to run.
    Forced,
    /// A parameter changed; the path is dotted, values are JSON, `None` where absent.
    Param {
        /// The parameter, as `total_timesteps` or `env.car-racing.time_limit`.
        path: String,
        /// Before.
        old: Option<String>,
        /// Now.
        new: Option<String>,
    },
    /// The seed changed.
    Seed {
        /// Before.
        old: Option<u64>,
        /// Now.
        new: Option<u64>,
    },
    /// The kind was revised: the same inputs give different outputs now.
    Revision {
        /// Before.
        old: u32,
        /// Now.
        new: u32,
    },
    /// The stage has another kind.
    Kind {
        /// Before.
        old: String,
        /// Now.
        new: String,
    },
    /// The content of an input changed.
    Input {
        /// The input's name.
        port: String,
        /// Its source: stage and output, or file.
        from: String,
        /// The digest before; `None` where there was no such artifact.
        #[serde(skip_serializing_if = "Option::is_none")]
        old: Option<Digest>,
        /// The digest now; `None` where there is no such artifact, or it is not built yet.
        #[serde(skip_serializing_if = "Option::is_none")]
        new: Option<Digest>,
    },
    /// An input has the same content, but its executable bit changed.
    Rights {
        /// The input's name.
        port: String,
        /// Its source: stage and output, or file.
        from: String,
        /// True where it is executable now.
        executable: bool,
    },
    /// The record exists, but an output is missing or incomplete.
    Lost {
        /// The output.
        output: String,
    },
    /// The record exists, but cannot be read.
    Damaged {
        /// What is wrong with it.
        error: String,
    },
}

/// Plans a graph: what would run, and why. `base` is the folder of the pipeline file, to which its paths are relative.
///
/// # Errors
/// A file from outside or the store cannot be read.
pub fn plan<'g>(graph: &'g Graph, store: &Store, base: &Path) -> Result<Plan<'g>, PlanError> {
    plan_forced(graph, store, base, BTreeSet::new())
}

/// As [`plan`], with stages that run even if they are cached.
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
        // For each stage that is not cached: the stages that will run and that it depends on, or itself.
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

/// The differences between a stage and its nearest earlier record, as far as its inputs are known; empty where nothing
/// differs.
pub(crate) fn why(
    graph: &Graph,
    stage: &StageInstance,
    done: &[Option<Arc<Outputs>>],
    files: &BTreeMap<String, OutsideFile>,
    store: &Store,
    history: &History,
) -> Result<Vec<Reason>, StoreError> {
    Ok(match lookup::earlier_record(store, history, &stage.id)? {
        Some(record) => compare::differences(graph, stage, &record, done, files),
        None => vec![Reason::New],
    })
}

/// The union of these lists, sorted; shared where they are all the same, since large graphs have long lists.
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
