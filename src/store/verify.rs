//! Verifies the store: hashes every blob, reads every record, and computes its key again.

use std::collections::HashSet;
use std::path::{Path, PathBuf};

use rayon::prelude::*;

use super::{Digest, Found, Key, KeyOf, Store, StoreError, hash_file};
use crate::fsx::{self, Entry};

/// Damage in the store.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Damage {
    /// A blob that does not match its digest.
    WrongContent {
        /// Its file.
        path: PathBuf,
        /// The digest that it has.
        seen: Digest,
    },
    /// A blob that cannot be read.
    Unreadable {
        /// Its file.
        path: PathBuf,
        /// The system's answer.
        error: String,
    },
    /// A writable blob. Repaired by making it read-only.
    Writable {
        /// Its file.
        path: PathBuf,
    },
    /// A file with a name that no blob or record has.
    Stray {
        /// Its path.
        path: PathBuf,
    },
    /// A record that cannot be read, or belongs to another key.
    BadRecord {
        /// Its file.
        path: PathBuf,
        /// What is wrong with it.
        error: String,
    },
    /// A record with a missing or incomplete output.
    LostOutput {
        /// Its file.
        path: PathBuf,
        /// Its stage.
        stage: String,
        /// The output.
        output: String,
    },
}

impl Damage {
    /// The file.
    pub fn path(&self) -> &Path {
        match self {
            Self::WrongContent { path, .. }
            | Self::Unreadable { path, .. }
            | Self::Writable { path }
            | Self::Stray { path }
            | Self::BadRecord { path, .. }
            | Self::LostOutput { path, .. } => path,
        }
    }

    /// A description.
    pub fn text(&self) -> String {
        match self {
            Self::WrongContent { seen, .. } => {
                format!("does not match its digest: its content is {}", seen.short())
            }
            Self::Unreadable { error, .. } => format!("cannot be read: {error}"),
            Self::Writable { .. } => "is writable, expected a read-only file".to_owned(),
            Self::Stray { .. } => "does not belong in the store".to_owned(),
            Self::BadRecord { error, .. } => format!("is not a valid record: {error}"),
            Self::LostOutput { stage, output, .. } => {
                format!("is the record of `{stage}`, whose output `{output}` is missing or incomplete")
            }
        }
    }
}

/// The result of verifying a store.
#[derive(Clone, Debug, Default)]
pub struct Verified {
    /// Blobs that were hashed.
    pub blobs: usize,
    /// Their bytes.
    pub bytes: u64,
    /// Records that were read.
    pub records: usize,
    /// Damage, sorted by path.
    pub damage: Vec<Damage>,
    /// The number of repaired entries.
    pub repaired: usize,
}

impl Store {
    /// Hashes every blob and reads every record. With `repair`, damaged files are moved to `quarantine-v1`, so that the stages that
    /// made them run again when needed.
    ///
    /// # Errors
    /// The store cannot be read, or (with `repair`) not be written.
    pub fn verify(&self, key_of: KeyOf, repair: bool) -> Result<Verified, StoreError> {
        let mut verified = Verified::default();
        let mut bad: HashSet<Digest> = HashSet::new();
        let blobs = self.sharded_files("blobs-v1")?;
        let looked: Vec<(u64, Option<Damage>)> =
            blobs.par_iter().map(|(path, name)| check_blob(path, name)).collect();
        for ((_, name), (bytes, damage)) in blobs.iter().zip(looked) {
            verified.blobs += 1;
            verified.bytes += bytes;
            if damage.as_ref().is_some_and(|damage| !matches!(damage, Damage::Writable { .. })) {
                bad.extend(name.parse::<Digest>());
            }
            verified.damage.extend(damage);
        }
        for (path, name) in self.sharded_files("records-v1")? {
            verified.records += 1;
            verified.damage.extend(self.check_record(path, &name, key_of, &bad)?);
        }
        if repair && !verified.damage.is_empty() {
            let _alone = self.hold_alone()?;
            for damage in &verified.damage {
                self.repair(damage)?;
                verified.repaired += 1;
            }
        }
        Ok(verified)
    }

    /// The files two folders deep, with the names that folder and file form together.
    pub(super) fn sharded_files(&self, folder: &str) -> Result<Vec<(PathBuf, String)>, StoreError> {
        let mut found = Vec::new();
        for shard in fsx::list(&self.root().join(folder))? {
            let first = shard.file_name().unwrap_or_default().to_string_lossy().into_owned();
            if fsx::entry(&shard)? != Some(Entry::Folder) {
                found.push((shard, first));
                continue;
            }
            for path in fsx::list(&shard)? {
                let rest = path.file_name().unwrap_or_default().to_string_lossy().into_owned();
                found.push((path, format!("{first}{rest}")));
            }
        }
        Ok(found)
    }

    fn check_record(
        &self,
        path: PathBuf,
        name: &str,
        key_of: KeyOf,
        bad: &HashSet<Digest>,
    ) -> Result<Option<Damage>, StoreError> {
        let Some(key) = name.strip_suffix(".json").and_then(|key| key.parse::<Key>().ok()) else {
            return Ok(Some(Damage::Stray { path }));
        };
        let record = match self.find(&key) {
            Ok(Found::Record(record)) => record,
            Ok(Found::Nothing) => return Ok(None),
            Ok(Found::Damaged(error)) => return Ok(Some(Damage::BadRecord { path, error })),
            Err(error) => return Ok(Some(Damage::BadRecord { path, error: error.to_string() })),
        };
        if key_of(&record) != Some(key) {
            let error = "it is the record of another key".to_owned();
            return Ok(Some(Damage::BadRecord { path, error }));
        }
        let mut lost = self.lost(&record.outputs)?;
        for (name, stored) in &record.outputs {
            if self.contents(stored)?.iter().any(|(digest, _)| bad.contains(digest)) {
                lost = Some(name.as_str());
                break;
            }
        }
        Ok(lost.map(|output| Damage::LostOutput {
            path,
            stage: record.stage.clone(),
            output: output.to_owned(),
        }))
    }

    fn repair(&self, damage: &Damage) -> Result<(), StoreError> {
        let path = damage.path();
        if let Damage::Writable { .. } = damage {
            return Ok(fsx::make_read_only(&fsx::open(path)?, path)?);
        }
        Ok(self.quarantine(path)?)
    }

    /// Moves a damaged file to quarantine.
    pub(super) fn quarantine(&self, path: &Path) -> fsx::Result<()> {
        // `gc` keeps it for some time from now, not from when its content was written.
        let _ = fsx::touch(path);
        let name = path.strip_prefix(self.root()).unwrap_or(path).to_string_lossy().replace('/', "-");
        match fsx::rename_into(path, &self.root().join("quarantine-v1").join(name)) {
            // Another process was faster.
            Err(error) if error.is_not_found() => Ok(()),
            result => result.map(drop),
        }
    }
}

fn check_blob(path: &Path, name: &str) -> (u64, Option<Damage>) {
    let path = path.to_owned();
    let unreadable =
        |path, error: fsx::FsError| Some(Damage::Unreadable { path, error: error.source.to_string() });
    let Ok(digest) = name.parse::<Digest>() else { return (0, Some(Damage::Stray { path })) };
    match fsx::entry(&path) {
        Ok(Some(Entry::File(_))) => {}
        // Removed since it was listed.
        Ok(None) => return (0, None),
        Ok(Some(_)) => return (0, Some(Damage::Stray { path })),
        Err(error) => return (0, unreadable(path, error)),
    }
    match hash_file(&path) {
        Ok((seen, bytes)) if seen != digest => (bytes, Some(Damage::WrongContent { path, seen })),
        Ok((_, bytes)) => {
            let writable = fsx::is_writable(&path).unwrap_or(false);
            (bytes, writable.then_some(Damage::Writable { path }))
        }
        Err(error) => (0, unreadable(path, error)),
    }
}
