//! The run of an archive, as its event log has it.

use std::collections::BTreeMap;
use std::io::{self, Read};
use std::path::Path;

use serde_json::Value;
use zip::ZipArchive;

use crate::fsx::{self, File, FsError};
use crate::store::past::stages_of;
use crate::store::{Key, StoreError};

/// The maximum size of the manifest and of the event log.
const LARGEST: u64 = 256 << 20;

/// A run in an archive. Nothing in it was verified: it gives names to keys, and no more.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct ArchivedRun {
    /// The pipeline's name; empty if the archive has no manifest.
    pub pipeline: String,
    /// The profile.
    pub profile: String,
    /// The key of each stage, by its id. Several stages may have one key.
    pub keys: BTreeMap<String, Key>,
}

impl ArchivedRun {
    /// Reads it from an archive.
    ///
    /// # Errors
    /// The archive cannot be read. What it lacks is left empty.
    pub fn read(path: &Path) -> Result<Self, StoreError> {
        let mut archive = ZipArchive::new(fsx::open(path)?)
            .map_err(|error| FsError::at("read", path)(io::Error::other(error)))?;
        let manifest: Value =
            serde_json::from_slice(&entry(&mut archive, "run/run.json")).unwrap_or_default();
        let (stages, _) = stages_of(&entry(&mut archive, "run/events.jsonl"));
        let text = |field: &str| manifest[field].as_str().unwrap_or_default().to_owned();
        let keys = stages.into_iter().filter_map(|(id, stage)| Some((id, stage.key?))).collect();
        Ok(Self { pipeline: text("pipeline"), profile: text("profile"), keys })
    }
}

/// The content of an entry; empty if it is missing or damaged.
fn entry(archive: &mut ZipArchive<File>, name: &str) -> Vec<u8> {
    let mut bytes = Vec::new();
    match archive.by_name(name).map(|entry| entry.take(LARGEST).read_to_end(&mut bytes)) {
        Ok(Ok(_)) => bytes,
        _ => Vec::new(),
    }
}
