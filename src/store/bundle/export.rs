//! Writes the archive of a run.

use std::collections::{BTreeMap, BTreeSet};
use std::io;
use std::path::Path;

use zip::write::SimpleFileOptions;
use zip::{CompressionMethod, ZipWriter};

use super::provenance::{Crate, describe};
use super::{BLOBS, RECORDS};
use crate::fsx::{self, File, FsError};
use crate::store::{Digest, Key, PastRun, Record, Store, StoreError};

type Zip<'f> = ZipWriter<&'f mut File>;

impl Store {
    /// Writes a run with all its results and their inputs to `path`. Returns the number of records and of blobs.
    ///
    /// # Errors
    /// A record or blob is missing or cannot be read, or the archive cannot be written; then there is no archive.
    pub fn export(&self, run: &PastRun, path: &Path) -> Result<(usize, usize), StoreError> {
        let _held = self.hold()?;
        let records = self.records_of(run)?;
        let mut blobs: BTreeMap<Digest, u64> = BTreeMap::new();
        for record in records.values() {
            if let Some(output) = self.lost(&record.outputs)? {
                return Err(StoreError::NotWhole(format!(
                    "output `{output}` of `{}` is no longer in the store; run the pipeline again",
                    record.stage
                )));
            }
            for stored in record.outputs.values() {
                blobs.extend(self.contents(stored)?);
            }
        }
        // Files from outside, as far as they still exist.
        for item in records.values().flat_map(|record| &record.inputs).flat_map(|input| &input.items) {
            if let Some(fsx::Entry::File(bytes)) = fsx::entry(&self.blob_path(&item.digest))? {
                blobs.insert(item.digest, bytes);
            }
        }
        let logs: BTreeSet<_> = fsx::list(&run.folder.join("logs"))?.into_iter().collect();
        fsx::fill_atomic(path, |file| {
            let mut zip = ZipWriter::new(file);
            let all = Crate { run, records: &records, blobs: &blobs, logs: &logs };
            let done =
                self.fill(&mut zip, &all).and_then(|()| zip.finish().map(drop).map_err(io::Error::other));
            done.map_err(FsError::at("write", path))
        })?;
        Ok((records.len(), blobs.len()))
    }

    fn fill(&self, zip: &mut Zip<'_>, all: &Crate<'_>) -> io::Result<()> {
        text(zip, "ro-crate-metadata.json", &format!("{:#}\n", describe(all)))?;
        for (name, source) in all.pipeline() {
            text(zip, &name, source)?;
        }
        for name in ["run.json", "events.jsonl"] {
            if let Some(bytes) = fsx::read_if_there(&all.run.folder.join(name)).map_err(io::Error::other)? {
                begin(zip, &format!("run/{name}"), bytes.len() as u64)?;
                io::Write::write_all(zip, &bytes)?;
            }
        }
        for (key, record) in all.records {
            text(zip, &format!("{RECORDS}{key}.json"), &serde_json::to_string(record)?)?;
        }
        for (digest, bytes) in all.blobs {
            begin(zip, &format!("{BLOBS}{digest}"), *bytes)?;
            io::copy(&mut fsx::open(&self.blob_path(digest)).map_err(io::Error::other)?, zip)?;
        }
        for log in all.logs {
            let name = format!("logs/{}", log.file_name().unwrap_or_default().to_string_lossy());
            let bytes = fsx::read(log).map_err(io::Error::other)?;
            begin(zip, &name, bytes.len() as u64)?;
            io::Write::write_all(zip, &bytes)?;
        }
        Ok(())
    }

    /// The records of all stages of the run.
    fn records_of(&self, run: &PastRun) -> Result<BTreeMap<Key, Record>, StoreError> {
        let mut records = BTreeMap::new();
        for (id, stage) in &run.stages {
            let Some(key) = stage.key else {
                return Err(StoreError::NotWhole(format!("`{id}` was {} in this run", stage.fate.name())));
            };
            match self.record(&key)? {
                Some(record) => drop(records.insert(key, record)),
                None => {
                    return Err(StoreError::NotWhole(format!(
                        "`{id}` was {} in this run, and the store has no result for it",
                        stage.fate.name()
                    )));
                }
            }
        }
        Ok(records)
    }
}

fn begin(zip: &mut Zip<'_>, name: &str, bytes: u64) -> io::Result<()> {
    let options = SimpleFileOptions::default()
        .compression_method(CompressionMethod::Stored)
        .last_modified_time(zip::DateTime::default())
        .unix_permissions(0o644)
        .large_file(bytes >= u64::from(u32::MAX));
    zip.start_file(name, options).map_err(io::Error::other)
}

fn text(zip: &mut Zip<'_>, name: &str, text: &str) -> io::Result<()> {
    begin(zip, name, text.len() as u64)?;
    io::Write::write_all(zip, text.as_bytes())
}
