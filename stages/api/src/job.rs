//! Job files: what the engine writes for the process that runs a stage, on this machine or another.

use std::collections::BTreeMap;
use std::path::PathBuf;

use serde::{Deserialize, Serialize};
use serde_json::Value;

use crate::Seed;

/// Matrix coordinates (axis = value) of the stage instance that an artifact comes from.
pub type Labels = BTreeMap<String, String>;

/// Everything a stage needs to run.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Job {
    /// The stage instance's name, for messages only.
    pub stage: String,
    /// The kind's name.
    pub kind: String,
    /// The kind's revision when the engine planned; a different one in the worker is an error.
    pub revision: u32,
    /// Normalised parameters.
    pub params: Value,
    /// The seed.
    pub seed: Seed,
    /// Input files by port.
    pub inputs: BTreeMap<String, Vec<JobInput>>,
    /// Output files by port.
    pub outputs: BTreeMap<String, JobOutput>,
    /// Folder for temporary files. It may not exist yet, and is removed afterwards.
    pub scratch: PathBuf,
    /// Folder for checkpoints, which survives a kill; emptied once the stage is done.
    pub checkpoints: PathBuf,
    /// Seconds between checkpoints.
    pub checkpoint_seconds: f64,
    /// Folder for live training curves, which are not results; none if not requested.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub curves: Option<PathBuf>,
}

/// One artifact at an input.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct JobInput {
    /// Path of the file or folder; read-only.
    pub path: PathBuf,
    /// The stage instance it comes from; empty for inputs that accept a single artifact.
    #[serde(default)]
    pub labels: Labels,
}

/// One output.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct JobOutput {
    /// Path to write to.
    pub path: PathBuf,
}
