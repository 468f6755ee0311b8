//! The named, typed inputs and outputs of a stage.

use std::collections::HashSet;
use std::sync::{LazyLock, Mutex, PoisonError};

use crate::Artifact;

/// How many artifacts an input takes.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Arity {
    /// Exactly one.
    One,
    /// None or one.
    Optional,
    /// One or more, each with the labels (axis = value) of the stage instance it comes from. The order is the order of
    /// the matrix, never the order in which stages finished.
    Many,
}

/// An input of a stage.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Input {
    /// The name used under `inputs:` in the pipeline file.
    pub name: &'static str,
    /// What it takes.
    pub artifact: Artifact,
    /// How many.
    pub arity: Arity,
    /// One line for people.
    pub about: &'static str,
}

/// An output of a stage.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Output {
    /// The name used in references, as in `dril.peak`.
    pub name: &'static str,
    /// What it is.
    pub artifact: Artifact,
    /// The ending of the file, without the dot: `csv`, `md`, `safetensors`.
    pub extension: &'static str,
    /// One line for people.
    pub about: &'static str,
}

/// The inputs and outputs of a stage. Names are unique on each side; there is at least one output.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Ports {
    /// What the stage reads.
    pub inputs: Vec<Input>,
    /// What the stage writes: all of them, each time.
    pub outputs: Vec<Output>,
    /// What the stage brings in from outside, where that is all it does: its one input is filled by the engine, and its
    /// one output is the same content. Nothing is run for it.
    pub outside: Option<Outside>,
    /// How to get a further input, where that is in the user's hands; for messages.
    pub hint: Option<&'static str>,
}

/// A file or folder from outside that the parameters of a stage name.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Outside {
    /// The parameter that names it: where messages point, and whose file's folder the path is relative to.
    pub param: &'static str,
    /// Where it is, relative to the folder of the pipeline file unless absolute.
    pub path: String,
    /// The content that it must have, as 64 hexadecimal digits of blake3.
    pub blake3: Option<String>,
    /// What of a folder is left out: globs of names, or of paths relative to the folder where they have a `/`.
    pub exclude: Vec<String>,
}

/// A port's name that comes from the parameters of a stage, as long-lived as one that is written in the code: wires,
/// plans and records refer to it. It stays in memory until the program ends; there are few distinct names.
pub fn port_name(text: &str) -> &'static str {
    static NAMES: LazyLock<Mutex<HashSet<&'static str>>> = LazyLock::new(Mutex::default);
    // A set is whole after every step, so a thread that died with the lock has broken nothing.
    let mut names = NAMES.lock().unwrap_or_else(PoisonError::into_inner);
    if let Some(name) = names.get(text) {
        return name;
    }
    let name: &'static str = String::leak(text.to_owned());
    names.insert(name);
    name
}

impl Ports {
    /// No ports yet; chain the other methods.
    pub fn new() -> Self {
        Self::default()
    }

    /// Adds an input that takes exactly one artifact.
    #[must_use]
    pub fn input(self, name: &'static str, artifact: Artifact, about: &'static str) -> Self {
        self.with_input(Input { name, artifact, arity: Arity::One, about })
    }

    /// Adds an input that may be left out.
    #[must_use]
    pub fn optional(self, name: &'static str, artifact: Artifact, about: &'static str) -> Self {
        self.with_input(Input { name, artifact, arity: Arity::Optional, about })
    }

    /// Adds an input that takes one or more labelled artifacts (fan-in).
    #[must_use]
    pub fn many(self, name: &'static str, artifact: Artifact, about: &'static str) -> Self {
        self.with_input(Input { name, artifact, arity: Arity::Many, about })
    }

    /// Adds an output.
    #[must_use]
    pub fn output(
        mut self,
        name: &'static str,
        artifact: Artifact,
        extension: &'static str,
        about: &'static str,
    ) -> Self {
        self.outputs.push(Output { name, artifact, extension, about });
        self
    }

    /// Adds an input.
    #[must_use]
    pub fn with_input(mut self, input: Input) -> Self {
        self.inputs.push(input);
        self
    }

    /// The input of that name.
    pub fn find_input(&self, name: &str) -> Option<&Input> {
        self.inputs.iter().find(|input| input.name == name)
    }

    /// The output of that name.
    pub fn find_output(&self, name: &str) -> Option<&Output> {
        self.outputs.iter().find(|output| output.name == name)
    }
}
