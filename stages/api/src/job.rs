//! A stage to run, as a file: what the engine writes for the child process (here or on another machine) that runs it.

use std::collections::BTreeMap;
use std::path::PathBuf;

use serde::{Deserialize, Serialize};
use serde_json::Value;

use crate::Seed;

/// Axis = value of the stage instance that an artifact comes from.
pub type Labels = BTreeMap<String, String>;

/// All that a stage needs in order to run.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Job {
    /// The stage instance's name, for messages only.
    pub stage: String,
    /// The kind's name.
    pub kind: String,
    /// The revision that the engine planned with; another one in the child is an error.
    pub revision: u32,
    /// Normalised parameters.
    pub params: Value,
    /// The seed.
    pub seed: Seed,
    /// Input files by port.
    pub inputs: BTreeMap<String, Vec<JobInput>>,
    /// The file to write for each output.
    pub outputs: BTreeMap<String, JobOutput>,
    /// A folder for this stage to work in; it may not be there yet, and is removed afterwards.
    pub scratch: PathBuf,
    /// A folder of this stage's own that outlives a kill; emptied once the stage is done.
    pub checkpoints: PathBuf,
    /// Seconds between checkpoints.
    pub checkpoint_seconds: f64,
    /// A folder for curves that people watch while the stage runs; nothing in it is a result. None where nobody does.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub curves: Option<PathBuf>,
}

/// One artifact at an input.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct JobInput {
    /// Where it is, a file or a folder; read-only.
    pub path: PathBuf,
    /// Where it comes from; empty for inputs that take one artifact.
    #[serde(default)]
    pub labels: Labels,
}

/// One file to write.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct JobOutput {
    /// Where to write it.
    pub path: PathBuf,
}
