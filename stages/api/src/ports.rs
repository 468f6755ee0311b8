//! The named, typed inputs and outputs of a stage.

use std::collections::HashSet;
use std::sync::{LazyLock, Mutex, PoisonError};

use crate::{Artifact, scores};

/// How many artifacts an input takes.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Arity {
    /// Exactly one.
    One,
    /// None or one.
    Optional,
    /// One or more, each with the labels (axis = value) of the stage instance it comes from; in matrix order, independent of
    /// the order in which stages finished.
    Many,
}

/// An input of a stage.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Input {
    /// The name used under `inputs:` in the pipeline file.
    pub name: &'static str,
    /// Accepted type.
    pub artifact: Artifact,
    /// Accepted number.
    pub arity: Arity,
    /// One-line description.
    pub about: &'static str,
}

/// An output of a stage.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Output {
    /// The name used in references, such as `dril.peak`.
    pub name: &'static str,
    /// Its type.
    pub artifact: Artifact,
    /// The file extension, without the dot: `csv`, `md`, `safetensors`.
    pub extension: &'static str,
    /// One-line description.
    pub about: &'static str,
    /// Every column that the CSV file can have, if that is known before it is made.
    pub columns: Option<Vec<&'static str>>,
}

/// The inputs and outputs of a stage. Names are unique on each side; there is at least one output.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Ports {
    /// What the stage reads.
    pub inputs: Vec<Input>,
    /// What the stage writes; it has to write all of them.
    pub outputs: Vec<Output>,
    /// For a stage that only imports an external file or folder: the engine fills its one input, and its one output has the
    /// same content. Nothing is run.
    pub outside: Option<Outside>,
    /// How the user can add an input, if that is possible; for messages.
    pub hint: Option<&'static str>,
}

/// An external file or folder, named by a parameter of a stage.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Outside {
    /// The parameter that names it, for messages and to resolve the relative path.
    pub param: &'static str,
    /// Its path, absolute or relative to the folder of the pipeline file.
    pub path: String,
    /// The required BLAKE3 digest of its content, as 64 hexadecimal digits.
    pub blake3: Option<String>,
    /// What to exclude from a folder: globs of names, or of relative paths if they contain a `/`.
    pub exclude: Vec<String>,
}

/// Converts a port name from the parameters of a stage to a static string, as used by wires, plans and records. It stays
/// in memory until the program ends; there are few distinct names.
pub fn port_name(text: &str) -> &'static str {
    static NAMES: LazyLock<Mutex<HashSet<&'static str>>> = LazyLock::new(Mutex::default);
    // The set is consistent after every step, so a poisoned lock is harmless.
    let mut names = NAMES.lock().unwrap_or_else(PoisonError::into_inner);
    if let Some(name) = names.get(text) {
        return name;
    }
    let name: &'static str = String::leak(text.to_owned());
    names.insert(name);
    name
}

impl Ports {
    /// No ports; chain the other methods.
    pub fn new() -> Self {
        Self::default()
    }

    /// Adds an input that accepts exactly one artifact.
    #[must_use]
    pub fn input(self, name: &'static str, artifact: Artifact, about: &'static str) -> Self {
        self.with_input(Input { name, artifact, arity: Arity::One, about })
    }

    /// Adds an optional input.
    #[must_use]
    pub fn optional(self, name: &'static str, artifact: Artifact, about: &'static str) -> Self {
        self.with_input(Input { name, artifact, arity: Arity::Optional, about })
    }

    /// Adds an input that accepts one or more labelled artifacts (fan-in).
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
        let columns = (artifact == Artifact::SCORES).then(|| scores::COLUMNS.to_vec());
        self.outputs.push(Output { name, artifact, extension, about, columns });
        self
    }

    /// States every column that the output which was added last, a CSV file, can have. For scores they are known anyway.
    #[must_use]
    pub fn columns(mut self, columns: &[&'static str]) -> Self {
        if let Some(output) = self.outputs.last_mut() {
            output.columns = Some(columns.to_vec());
        }
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
