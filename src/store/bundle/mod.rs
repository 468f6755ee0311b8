//! A run as one archive: a zip file that is a Workflow Run RO-Crate, and from which a store elsewhere can be refilled.
//!
//! ```text
//! ro-crate-metadata.json     what is in it and what made what, for people and programs that know RO-Crate
//! pipeline.yaml              the pipeline file of the run, where the run noted it
//! run/run.json, events.jsonl the run's own notes
//! records/<key>.json         as in the store
//! blobs/<digest>             as in the store
//! logs/<stage>-<key>.log
//! ```
//!
//! Entries are stored without compression and without times, so that the same run gives the same bytes.

mod export;
mod import;
mod provenance;

pub use import::{Imported, Refusal};

/// Folder of the archive for records.
const RECORDS: &str = "records/";
/// Folder of the archive for contents.
const BLOBS: &str = "blobs/";
