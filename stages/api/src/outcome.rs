//! A pipeline with all that its store knows of it: what the engine hands to whoever writes a page about it.
//!
//! It is plain data with no clock in it: equal stores give equal values.

use std::collections::BTreeMap;
use std::path::PathBuf;

use serde_json::Value;

use crate::Artifact;

/// A pipeline and its stages.
#[derive(Clone, Debug, PartialEq)]
pub struct Outcome {
    /// The pipeline's name.
    pub pipeline: String,
    /// The profile.
    pub profile: String,
    /// The profile that is used when none is named, where the file has profiles.
    pub first_profile: Option<String>,
    /// The command line that brings it up to date.
    pub command: Vec<String>,
    /// The name and version of the program that looked.
    pub tool: String,
    /// Its stage instances, in the order of the file and its matrices.
    pub stages: Vec<StageOutcome>,
}

/// A stage instance.
#[derive(Clone, Debug, PartialEq)]
pub struct StageOutcome {
    /// The stage's name in the file.
    pub name: String,
    /// Name and coordinates.
    pub id: String,
    /// Axis and value, in the order of the stage's matrix.
    pub labels: Vec<(String, String)>,
    /// The name of its kind.
    pub kind: String,
    /// The kind's revision.
    pub revision: u32,
    /// All parameters.
    pub params: Value,
    /// Those that differ from the kind's defaults, or have none.
    pub chosen: BTreeMap<String, Value>,
    /// The seed, where it draws random numbers.
    pub seed: Option<u64>,
    /// How it stands.
    pub state: State,
    /// The key, where it is known.
    pub key: Option<String>,
    /// What it reads, in the order of its ports.
    pub inputs: Vec<InputOutcome>,
    /// What it made; empty where it is not done.
    pub outputs: Vec<OutputOutcome>,
    /// How long it ran.
    pub seconds: Option<f64>,
    /// What it was made with: program, platform, libraries.
    pub made_with: BTreeMap<String, String>,
}

/// How a stage stands.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum State {
    /// Its result is there.
    Done,
    /// It runs now.
    Running,
    /// It is to be run.
    Stale,
    /// The last try failed, with this message.
    Failed(String),
    /// It depends on others that are to be run.
    Waiting,
}

/// An artifact that a stage reads.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct InputOutcome {
    /// The input's name.
    pub port: String,
    /// Which stage it comes from, by its place in [`Outcome::stages`]; `None` for a file from outside.
    pub stage: Option<usize>,
    /// The output's name, or the file as the pipeline names it.
    pub from: String,
    /// Its labels.
    pub labels: BTreeMap<String, String>,
}

/// An artifact that a stage made.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct OutputOutcome {
    /// The output's name.
    pub name: String,
    /// Its type.
    pub artifact: Artifact,
    /// The ending of its file, without the dot.
    pub extension: String,
    /// The name of its content, in hexadecimal digits.
    pub digest: String,
    /// Its size.
    pub bytes: u64,
    /// Where the content lies; never to be shown, since it says where somebody keeps files.
    pub path: PathBuf,
    /// The name of its copy in the results folder, beside the page.
    pub file: Option<String>,
}
