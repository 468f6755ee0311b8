//! Tools: subcommands that a stage package brings along and that work on one finished artifact.
//!
//! A [`Tool`] only describes the command line. The engine parses it, finds the artifact (a file, or an output of a stage of a
//! pipeline), and starts the tool's executable with everything as one JSON object.

use crate::Artifact;

/// A subcommand that works on one artifact.
///
/// Its executable is called as `WORKER SERVICE REQUEST`. The request is a JSON object: the path of the artifact under the name
/// of its type, and every option under its name. An option without value and default is `null`.
#[derive(Clone, Copy, Debug)]
pub struct Tool {
    /// The subcommand.
    pub name: &'static str,
    /// One line for `--help`.
    pub about: &'static str,
    /// Example command lines, one per line.
    pub examples: &'static [&'static str],
    /// The type of the artifact.
    pub artifact: Artifact,
    /// What `--help` calls the argument that names the artifact, as `POLICY`.
    pub value_name: &'static str,
    /// One line about that argument.
    pub artifact_about: &'static str,
    /// An example of a stage with such an output, as in `thesis.yaml:dril.peak[policy=beta]`; for hints.
    pub artifact_example: &'static str,
    /// The options, in the order of `--help`.
    pub options: &'static [ToolOption],
    /// The executable, in the folder of this one.
    pub worker: &'static str,
    /// Its first argument.
    pub service: &'static str,
}

/// An option of a tool.
#[derive(Clone, Copy, Debug)]
pub struct ToolOption {
    /// `seed` for `--seed`, and for the request.
    pub name: &'static str,
    /// One line for `--help`.
    pub about: &'static str,
    /// What it takes.
    pub value: ToolValue,
    /// The default as text; `None` for an option that is required or optional.
    pub default: Option<&'static str>,
    /// True where it must be given.
    pub required: bool,
    /// True where, if it is not given, the value is the parameter of the same name of the artifact's stage, or of the nearest
    /// stage upstream that has one.
    pub from_stage: bool,
}

/// What an option takes.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum ToolValue {
    /// A whole number, 0 or more.
    Count,
    /// A number.
    Number,
    /// A value in YAML, as in a pipeline file; with an example for messages.
    Yaml(&'static str),
    /// One of these words.
    Choice(&'static [&'static str]),
    /// The path of a file to write, with one of these extensions; and a hint what each is for.
    NewFile(&'static [&'static str], &'static str),
}

impl ToolOption {
    /// An option with a default.
    pub const fn new(
        name: &'static str,
        value: ToolValue,
        default: &'static str,
        about: &'static str,
    ) -> Self {
        Self { name, about, value, default: Some(default), required: false, from_stage: false }
    }

    /// An option that must be given.
    pub const fn required(name: &'static str, value: ToolValue, about: &'static str) -> Self {
        Self { name, about, value, default: None, required: true, from_stage: false }
    }

    /// An option whose default is a parameter of the artifact's stage.
    pub const fn from_stage(name: &'static str, value: ToolValue, about: &'static str) -> Self {
        Self { name, about, value, default: None, required: false, from_stage: true }
    }
}
