//! The record of a key: the file that says that a stage is done, what it was made from, and its outputs.

use std::collections::BTreeMap;

use dril_stage_api::Labels;
use serde::{Deserialize, Serialize};
use serde_json::Value;

use super::Digest;

/// The version of the record format; it is also part of the folder's name.
pub const RECORD_VERSION: u32 = 1;

/// A finished stage: everything that entered its key, and its outputs.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Record {
    /// [`RECORD_VERSION`].
    pub version: u32,
    /// The stage instance that first built it; for people, never part of the key.
    pub stage: String,
    /// The kind's name.
    pub kind: String,
    /// The kind's revision.
    pub revision: u32,
    /// Normalised parameters.
    pub params: Value,
    /// The seed; `None` where the kind is not seeded.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub seed: Option<u64>,
    /// The artifacts of each input.
    pub inputs: Vec<RecordInput>,
    /// The outputs by name.
    pub outputs: Outputs,
    /// The seconds that the stage computed: its last process, and earlier ones up to the checkpoint that they left.
    pub seconds: f64,
    /// What built it; never part of the key.
    pub fingerprint: Fingerprint,
}

impl Record {
    /// The first output whose content another record of the same key has differently.
    pub fn differing_output(&self, other: &Self) -> Option<&str> {
        let differs = |(name, stored): &(&String, &Stored)| {
            other.outputs.get(*name).is_none_or(|other| other.digest != stored.digest)
        };
        self.outputs.iter().find(differs).map(|(name, _)| name.as_str())
    }
}

/// The published outputs of a stage, by output name.
pub type Outputs = BTreeMap<String, Stored>;

/// An artifact in the store.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Stored {
    /// The digest of its content.
    pub digest: Digest,
    /// Its size.
    pub bytes: u64,
    /// The file extension that its output declares, without the dot.
    pub extension: String,
    /// True for a folder: the blob is then the list of its files (see [`Store::contents`](super::Store::contents)).
    #[serde(default, skip_serializing_if = "std::ops::Not::not")]
    pub folder: bool,
    /// True for an executable file; files of a folder are marked in its list.
    #[serde(default, skip_serializing_if = "std::ops::Not::not")]
    pub executable: bool,
}

/// The artifacts of one input.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct RecordInput {
    /// The input's name.
    pub port: String,
    /// True where the input takes many: then labels are part of the key.
    pub many: bool,
    /// The artifacts, in the order of the matrix.
    pub items: Vec<RecordItem>,
}

/// One artifact of an input.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct RecordItem {
    /// Its origin, as `dril[policy=beta].peak` or `file reference/table22.csv`; for people, never part of the key.
    pub from: String,
    /// Its labels.
    #[serde(default, skip_serializing_if = "BTreeMap::is_empty")]
    pub labels: Labels,
    /// The digest of its content.
    pub digest: Digest,
    /// True where it is executable and the stage can execute it: this is part of the key.
    #[serde(default, skip_serializing_if = "std::ops::Not::not")]
    pub executable: bool,
}

/// The program and platform that built a record.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Fingerprint {
    /// The version of this program.
    pub tool: String,
    /// Operating system and processor architecture, as `linux x86_64`.
    pub platform: String,
    /// What the stage was computed with: versions of libraries and instruction sets, which may differ between machines.
    #[serde(default, skip_serializing_if = "BTreeMap::is_empty")]
    pub with: BTreeMap<String, String>,
}

impl Fingerprint {
    /// The fingerprint of the running program.
    pub fn current() -> Self {
        Self {
            tool: env!("CARGO_PKG_VERSION").to_owned(),
            platform: format!("{} {}", std::env::consts::OS, std::env::consts::ARCH),
            with: BTreeMap::new(),
        }
    }
}
