//! A run as one archive: a zip file that is a Workflow Run RO-Crate and that another store can import.
//!
//! ```text
//! ro-crate-metadata.json     contents and provenance, for people and programs that know RO-Crate
//! pipeline.yaml              the pipeline file, if it is in the run's manifest
//! run/run.json, events.jsonl manifest and event log of the run
//! records/<key>.json         as in the store
//! blobs/<digest>             as in the store
//! logs/<stage>-<key>.log
//! ```
//!
//! Entries are stored without compression and without times, so that the same run gives the same bytes.

mod export;
mod import;
mod named;
mod provenance;

pub use import::{Imported, Refusal};
pub use named::ArchivedRun;

/// Folder of the archive for records.
const RECORDS: &str = "records/";
/// Folder of the archive for blobs.
const BLOBS: &str = "blobs/";
