//! A pipeline with its results, as passed from the engine to the HTML report.
//!
//! It is plain data without times of day: equal stores give equal values.

use std::collections::BTreeMap;
use std::path::PathBuf;

use serde_json::Value;

use crate::Artifact;

/// A pipeline and its stages.
#[derive(Clone, Debug, PartialEq)]
pub struct PipelineOutcome {
    /// The pipeline's name.
    pub pipeline: String,
    /// The profile.
    pub profile: String,
    /// The default profile, if the file has profiles.
    pub first_profile: Option<String>,
    /// The command line that updates it.
    pub command: Vec<String>,
    /// Name and version of the program.
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
    /// Its state.
    pub state: State,
    /// The key, where it is known.
    pub key: Option<String>,
    /// Its inputs, in the order of its ports.
    pub inputs: Vec<InputOutcome>,
    /// Its outputs; empty if it is not done.
    pub outputs: Vec<OutputOutcome>,
    /// How long it ran.
    pub seconds: Option<f64>,
    /// Provenance: program, platform, libraries.
    pub made_with: BTreeMap<String, String>,
}

/// The state of a stage.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum State {
    /// Its result is cached.
    Done,
    /// It is running.
    Running,
    /// It has to be run.
    Stale,
    /// The last attempt failed, with this message.
    Failed(String),
    /// It depends on stages that have to be run.
    Waiting,
}

/// An artifact that a stage reads.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct InputOutcome {
    /// The input's name.
    pub port: String,
    /// The index in [`PipelineOutcome::stages`] of the stage that it comes from; `None` for an external file.
    pub stage: Option<usize>,
    /// The output's name, or the file as the pipeline names it.
    pub from: String,
    /// Its labels.
    pub labels: BTreeMap<String, String>,
    /// The path of an external file; `None` for an output of a stage. Never shown, since it reveals local paths.
    pub path: Option<PathBuf>,
}

/// An output of a stage.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct OutputOutcome {
    /// The output's name.
    pub name: String,
    /// Its type.
    pub artifact: Artifact,
    /// Its file extension, without the dot.
    pub extension: String,
    /// The digest of its content, in hexadecimal digits.
    pub digest: String,
    /// Its size.
    pub bytes: u64,
    /// The path of the content; never shown, since it reveals local paths.
    pub path: PathBuf,
    /// The name of its copy in the results folder.
    pub file: Option<String>,
}
