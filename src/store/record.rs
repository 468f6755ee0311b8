//! What was made, from what: the one file per key that says that a stage is done.

use std::collections::BTreeMap;

use dril_stage_api::Labels;
use serde::{Deserialize, Serialize};
use serde_json::Value;

use super::Digest;

/// The version of the record format; it also stands in the name of the records' folder.
pub const RECORD_VERSION: u32 = 1;

/// One piece of finished work: all that went into its key, and what came out.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Record {
    /// [`RECORD_VERSION`].
    pub version: u32,
    /// The stage instance that first made it; for people, never part of the key.
    pub stage: String,
    /// The kind's name.
    pub kind: String,
    /// The kind's revision.
    pub revision: u32,
    /// Normalised parameters.
    pub params: Value,
    /// The seed; `None` where the kind draws no random number.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub seed: Option<u64>,
    /// What was wired to each input.
    pub inputs: Vec<RecordInput>,
    /// What came out, by output name.
    pub outputs: Outputs,
    /// How long the stage's process ran.
    pub seconds: f64,
    /// What made it; never part of the key.
    pub fingerprint: Fingerprint,
}

/// The published outputs of a stage, by output name.
pub type Outputs = BTreeMap<String, Stored>;

/// An artifact in the store.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Stored {
    /// The name of its content.
    pub digest: Digest,
    /// Its size.
    pub bytes: u64,
    /// The ending that its output declares, without the dot.
    pub extension: String,
    /// True for a folder: the content is then the list of its files (see [`Store::contents`](super::Store::contents)).
    #[serde(default, skip_serializing_if = "std::ops::Not::not")]
    pub folder: bool,
    /// True for a file that may be executed; those of a folder are marked in its list.
    #[serde(default, skip_serializing_if = "std::ops::Not::not")]
    pub executable: bool,
}

/// What was wired to one input.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct RecordInput {
    /// The input's name.
    pub port: String,
    /// True where the input takes many: then labels are part of the key.
    pub many: bool,
    /// The artifacts, in the order of the matrix.
    pub items: Vec<RecordItem>,
}

/// One artifact at an input.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct RecordItem {
    /// Where it came from, as `dril[policy=beta].peak` or `file reference/table22.csv`; for people, never part of the key.
    pub from: String,
    /// Its labels.
    #[serde(default, skip_serializing_if = "BTreeMap::is_empty")]
    pub labels: Labels,
    /// The name of its content.
    pub digest: Digest,
    /// True where it may be executed and the stage can make use of that: it is part of the key then.
    #[serde(default, skip_serializing_if = "std::ops::Not::not")]
    pub executable: bool,
}

/// What made a record.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Fingerprint {
    /// The version of this program.
    pub tool: String,
    /// Operating system and processor architecture, as `linux x86_64`.
    pub platform: String,
    /// What the stage says it was computed with: libraries and instruction sets that other machines may have otherwise.
    #[serde(default, skip_serializing_if = "BTreeMap::is_empty")]
    pub with: BTreeMap<String, String>,
}

impl Fingerprint {
    /// Of the running program.
    pub fn current() -> Self {
        Self {
            tool: env!("CARGO_PKG_VERSION").to_owned(),
            platform: format!("{} {}", std::env::consts::OS, std::env::consts::ARCH),
            with: BTreeMap::new(),
        }
    }
}
