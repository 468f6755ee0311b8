//! What all stages of a run share: the graph and its files, the store, the runner, the settings, and the stop flag.

use std::collections::{BTreeMap, BTreeSet};
use std::sync::atomic::AtomicBool;

use super::options::Options;
use super::runner::Runner;
use crate::plan::{Order, OutsideFile};
use crate::resolve::{Graph, StageIndex};
use crate::store::{Key, Store};

/// Shared by the dispatcher and all workers of a run.
#[derive(Clone, Copy)]
pub(super) struct RunContext<'a> {
    pub graph: &'a Graph,
    /// Files from outside, by their paths in the pipeline file.
    pub files: &'a BTreeMap<String, OutsideFile>,
    pub order: &'a Order,
    /// Stages that run even if they are cached.
    pub forced: &'a BTreeSet<StageIndex>,
    pub store: &'a Store,
    pub runner: &'a dyn Runner,
    pub options: &'a Options,
    /// Set when running stages must stop.
    pub halt: &'a AtomicBool,
}

impl RunContext<'_> {
    /// The file name of a stage's log, without extension: readable, and unique through the key.
    pub fn log_name(&self, stage: StageIndex, key: Option<&Key>) -> String {
        let key = key.map(Key::short).unwrap_or_default();
        let stem: String = self.graph.stages[stage].file_stem().chars().take(40).collect();
        format!("{stem}-{key}")
    }
}
