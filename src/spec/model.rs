//! The contents of a pipeline file, each with its place. Nothing is filled in, merged or looked up yet.

use std::collections::HashMap;
use std::sync::Arc;

use super::SourceName;
use super::limits::{Limits, Resources};
use super::node::{Key, Node};
use super::problem::ProblemList;
use super::source::SourceText;

/// A parsed pipeline file.
///
/// It may contain problems, such as a misspelt key; [`crate::resolve::resolve`] reports them together with its own.
#[derive(Clone, Debug)]
pub struct Spec {
    pub(crate) name: SourceName,
    /// The file and its included files.
    pub(crate) sources: Vec<Arc<SourceText>>,
    pub(crate) problems: ProblemList,
    /// The pipeline's name; empty where it is missing.
    pub(crate) pipeline: String,
    /// Every param and axis by name, with its first value.
    pub(crate) base: Layer,
    /// Seed, params, axes and defaults of each file, those of an included file before those of the file that includes it.
    /// The stages' own `with` are in `stages`.
    pub(crate) files: Vec<Layer>,
    pub(crate) stages: Vec<Stage>,
    pub(crate) profiles: Vec<Profile>,
}

impl Spec {
    /// The name of the file in messages.
    pub fn source_name(&self) -> &SourceName {
        &self.name
    }

    /// The pipeline's name.
    pub fn pipeline(&self) -> &str {
        &self.pipeline
    }

    /// The profiles, in the order of the file; the first one is the default.
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
    /// From the entries of a map, whose keys are distinct.
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
    /// `None` where it is missing or not a text, which is reported.
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
    /// The number of its `zip`.
    pub group: Option<usize>,
}

/// The rules that add to or remove from the product of a matrix.
#[derive(Clone, Debug, Default)]
pub(crate) struct Rules {
    pub include: Option<Node>,
    pub exclude: Option<Node>,
    pub when: Option<Node>,
}

/// The shared values of all stages of a kind.
#[derive(Clone, Debug)]
pub(crate) struct Defaults {
    pub kind: Key,
    pub with: Option<Node>,
    pub inputs: Vec<(Key, Node)>,
}

/// Values that can be overridden: by the file, then by a profile, then by each `--set`. Later ones win.
#[derive(Clone, Debug, Default)]
pub(crate) struct Layer {
    pub seed: Option<Node>,
    pub params: Entries,
    pub axes: Entries,
    pub defaults: Vec<Defaults>,
    /// Stage -> overrides of its `with`.
    pub stages: Entries,
}

/// A profile as written.
#[derive(Clone, Debug)]
pub(crate) struct Profile {
    pub name: Key,
    /// Of each file that has it, in the order of files.
    pub layers: Vec<Layer>,
}
