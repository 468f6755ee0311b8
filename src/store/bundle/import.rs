//! Imports an archive into a store. Nothing in the archive is trusted: every blob is hashed, the key of every record is computed
//! again, and no name from the archive becomes a path.

use std::collections::{BTreeMap, HashSet};
use std::io::{self, Read};
use std::path::Path;

use serde_json::json;
use zip::ZipArchive;

use super::{BLOBS, RECORDS};
use crate::fsx::{self, File, FsError};
use crate::store::{
    Digest, Fingerprint, Key, KeyOf, RECORD_VERSION, Record, Run, Store, StoreError, hash_file,
};

/// The maximum size of a record.
const LARGEST_RECORD: u64 = 64 << 20;

/// The result of an import.
#[derive(Clone, Debug, Default)]
pub struct Imported {
    /// New results.
    pub records: usize,
    /// Results that were in the store already.
    pub known: usize,
    /// New blobs.
    pub blobs: usize,
    /// What was not imported, and why.
    pub refused: Vec<Refusal>,
}

/// An entry of an archive that was not imported.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Refusal {
    /// Its name in the archive.
    pub name: String,
    /// What was seen and what was expected.
    pub why: String,
}

impl Store {
    /// Imports the valid entries of an archive.
    ///
    /// # Errors
    /// The archive cannot be read, or the store cannot be written; what was imported until then is complete.
    pub fn import_archive(&self, path: &Path, key_of: KeyOf) -> Result<Imported, StoreError> {
        let mut archive = ZipArchive::new(fsx::open(path)?)
            .map_err(|error| FsError::at("read", path)(io::Error::other(error)))?;
        let run = self.begin_run(&json!({
            "version": 1, "pipeline": "", "profile": "", "import": path.to_string_lossy(),
            "fingerprint": Fingerprint::current(),
        }))?;
        let mut import = Import { store: self, run: &run, key_of, imported: Imported::default() };
        let names: Vec<String> =
            archive.file_names().filter_map(|name| Some(name.ok()?.into_owned())).collect();
        let records = import.records(&mut archive, &names);
        import.take(&mut archive, path, &names, records)?;
        let imported = import.imported;
        fsx::remove_dir_all(run.folder())?;
        Ok(imported)
    }
}

struct Import<'a> {
    store: &'a Store,
    run: &'a Run,
    key_of: KeyOf,
    imported: Imported,
}

impl Import<'_> {
    fn refuse(&mut self, name: &str, why: impl Into<String>) {
        self.imported.refused.push(Refusal { name: name.to_owned(), why: why.into() });
    }

    /// The valid records.
    fn records(&mut self, archive: &mut ZipArchive<File>, names: &[String]) -> BTreeMap<Key, Record> {
        let mut records = BTreeMap::new();
        for name in names {
            let Some(key) = name.strip_prefix(RECORDS).filter(|rest| !rest.is_empty()) else { continue };
            let Some(key) = key.strip_suffix(".json").and_then(|key| key.parse::<Key>().ok()) else {
                self.refuse(name, "its name is not a key");
                continue;
            };
            let mut bytes = Vec::new();
            let read = archive.by_name(name).map_err(io::Error::other);
            let read = read.and_then(|entry| entry.take(LARGEST_RECORD).read_to_end(&mut bytes));
            let record = match read.map(|_| serde_json::from_slice::<Record>(&bytes)) {
                Ok(Ok(record)) => record,
                Ok(Err(error)) => {
                    self.refuse(name, format!("it is not a valid record: {error}"));
                    continue;
                }
                Err(error) => {
                    self.refuse(name, format!("it cannot be read: {error}"));
                    continue;
                }
            };
            if record.version != RECORD_VERSION {
                self.refuse(name, format!("it has version {}, expected {RECORD_VERSION}", record.version));
            } else if (self.key_of)(&record) != Some(key) {
                self.refuse(name, "its key does not match its name");
            } else {
                records.insert(key, record);
            }
        }
        records
    }

    /// Imports the blobs of the records, then the records whose blobs are complete.
    fn take(
        &mut self,
        archive: &mut ZipArchive<File>,
        path: &Path,
        names: &[String],
        records: BTreeMap<Key, Record>,
    ) -> Result<(), StoreError> {
        let there: HashSet<&str> = names.iter().map(String::as_str).collect();
        let folder = self.run.temporary().join("import");
        fsx::create_dir(&folder)?;
        let mut wanted: BTreeMap<Digest, Option<u64>> = BTreeMap::new();
        for record in records.values() {
            let read = record.inputs.iter().flat_map(|input| &input.items).map(|item| (item.digest, None));
            wanted.extend(read.filter(|(digest, _)| there.contains(&*format!("{BLOBS}{digest}"))));
        }
        for stored in records.values().flat_map(|record| record.outputs.values()) {
            wanted.insert(stored.digest, Some(stored.bytes));
        }
        for (digest, bytes) in wanted {
            self.take_blob(archive, path, &folder, digest, bytes)?;
        }
        // The files of a folder are known once its list is imported and hashed.
        let mut inside: BTreeMap<Digest, u64> = BTreeMap::new();
        for stored in
            records.values().flat_map(|record| record.outputs.values()).filter(|stored| stored.folder)
        {
            inside.extend(self.store.contents(stored)?.into_iter().skip(1));
        }
        for (digest, bytes) in inside {
            self.take_blob(archive, path, &folder, digest, Some(bytes))?;
        }
        for (key, record) in records {
            if let Some(output) = self.store.lost(&record.outputs)? {
                let why = format!("its output `{output}` is neither in the archive nor in the store");
                self.refuse(&format!("{RECORDS}{key}.json"), why);
            } else if self.store.has_record(&key)? {
                self.imported.known += 1;
            } else {
                self.store.commit(&key, &record, &[], &folder)?;
                self.imported.records += 1;
            }
        }
        Ok(())
    }

    fn take_blob(
        &mut self,
        archive: &mut ZipArchive<File>,
        path: &Path,
        folder: &Path,
        digest: Digest,
        bytes: Option<u64>,
    ) -> Result<(), StoreError> {
        let name = format!("{BLOBS}{digest}");
        {
            self.run.rely_on([], [digest])?;
            let _held = self.store.hold()?;
            if matches!(fsx::entry(&self.store.blob_path(&digest))?, Some(fsx::Entry::File(there)) if bytes.is_none_or(|bytes| bytes == there))
            {
                return Ok(());
            }
        }
        let Ok(entry) = archive.by_name(&name) else { return Ok(()) };
        // Reading one byte more than expected is enough to see that it is too long.
        let limit = bytes.unwrap_or_else(|| entry.size()).saturating_add(1);
        let copy = folder.join(digest.hex());
        if let Err(error) = fsx::write_from(&copy, entry.take(limit)) {
            if error.path == copy && error.source.kind() == io::ErrorKind::InvalidData {
                self.refuse(&name, format!("it cannot be read from `{}`: {}", path.display(), error.source));
                return Ok(());
            }
            return Err(error.into());
        }
        let (seen, _) = hash_file(&copy)?;
        if seen == digest {
            self.store.take(&copy)?.sync()?;
            self.imported.blobs += 1;
        } else {
            fsx::remove_file(&copy)?;
            self.refuse(&name, format!("its content is {}, which does not match its name", seen.short()));
        }
        Ok(())
    }
}
