//! What a pipeline file says, part by part, each with its place. Nothing is filled in, merged or looked up yet.

use std::collections::HashMap;
use std::sync::Arc;

use super::SourceName;
use super::limits::{Limits, Resources};
use super::node::{Key, Node};
use super::problem::Problems;
use super::source::Source;

/// A pipeline file that was read.
///
/// It may still hold mistakes: those that reading found, such as a misspelt key, wait for [`crate::resolve::resolve`],
/// which reports them together with its own.
#[derive(Clone, Debug)]
pub struct Spec {
    pub(crate) name: SourceName,
    /// The file, and those that it includes.
    pub(crate) sources: Vec<Arc<Source>>,
    pub(crate) problems: Problems,
    /// The pipeline's name; empty where it is missing.
    pub(crate) pipeline: String,
    /// Every param and axis by its name, with its first value: what there is.
    pub(crate) base: Layer,
    /// Seed, params, axes and defaults of each file, those of an included file before those of the file that includes it.
    /// The stages' own `with` stand in `stages`.
    pub(crate) files: Vec<Layer>,
    pub(crate) stages: Vec<Stage>,
    pub(crate) profiles: Vec<Profile>,
}

impl Spec {
    /// The file that it was read from, as messages show it.
    pub fn source_name(&self) -> &SourceName {
        &self.name
    }

    /// The pipeline's name.
    pub fn pipeline(&self) -> &str {
        &self.pipeline
    }

    /// The profiles, in the order of the file; the first is the one that holds without a choice.
    pub fn profiles(&self) -> impl Iterator<Item = &str> {
        self.profiles.iter().map(|profile| &*profile.name.text)
    }

    /// The names of the stages, in the order of the file.
    pub fn stages(&self) -> impl Iterator<Item = &str> {
        self.stages.iter().map(|stage| &*stage.name.text)
    }
}

/// Values by name, in the order of the file.
#[derive(Clone, Debug, Default)]
pub(crate) struct Entries {
    list: Vec<(Key, Node)>,
    index: HashMap<Arc<str>, usize>,
}

impl Entries {
    /// Of a map's entries, whose keys are distinct.
    pub fn new(list: Vec<(Key, Node)>) -> Self {
        let index = list.iter().enumerate().map(|(at, (key, _))| (key.text.clone(), at)).collect();
        Self { list, index }
    }

    /// The value of that name.
    pub fn get(&self, name: &str) -> Option<&Node> {
        self.index.get(name).map(|at| &self.list[*at].1)
    }

    /// All of them.
    pub fn iter(&self) -> impl Iterator<Item = &(Key, Node)> {
        self.list.iter()
    }
}

/// A stage as written.
#[derive(Clone, Debug)]
pub(crate) struct Stage {
    pub name: Key,
    /// `None` where it is missing or no text, which is reported.
    pub kind: Option<Key>,
    pub matrix: Vec<MatrixAxis>,
    pub rules: Rules,
    pub seed: Option<Node>,
    pub with: Option<Node>,
    pub inputs: Vec<(Key, Node)>,
    pub limits: Limits,
    pub resources: Resources,
}

/// An axis of a stage's matrix.
#[derive(Clone, Debug)]
pub(crate) struct MatrixAxis {
    pub name: Key,
    /// Values given here; `None` takes those under `axes`.
    pub values: Option<Node>,
    /// The number of the `zip` that it stands in.
    pub group: Option<usize>,
}

/// What adds to the product of a matrix, and what takes away from it.
#[derive(Clone, Debug, Default)]
pub(crate) struct Rules {
    pub include: Option<Node>,
    pub exclude: Option<Node>,
    pub when: Option<Node>,
}

/// What all stages of a kind share.
#[derive(Clone, Debug)]
pub(crate) struct Defaults {
    pub kind: Key,
    pub with: Option<Node>,
    pub inputs: Vec<(Key, Node)>,
}

/// Values that may be given more than once: by the file, then by a profile, then by each `--set`. Later ones win.
#[derive(Clone, Debug, Default)]
pub(crate) struct Layer {
    pub seed: Option<Node>,
    pub params: Entries,
    pub axes: Entries,
    pub defaults: Vec<Defaults>,
    /// Stage -> what goes over its `with`.
    pub stages: Entries,
}

/// A profile as written.
#[derive(Clone, Debug)]
pub(crate) struct Profile {
    pub name: Key,
    /// Of each file that has it, in the order of files.
    pub layers: Vec<Layer>,
}
