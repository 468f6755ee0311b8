//! The content-addressed store: blobs by the digest of their content, records by the key of the stage that made them. A record
//! is written last, so a crash leaves garbage and never half a result. See `docs/design/store.md`.

mod blob;
mod bundle;
mod complete;
mod copies;
mod digest;
mod folder;
mod history;
mod in_use;
mod parsed;
mod past;
mod record;
mod run;
mod stats;
mod sweep;
mod usage;
mod verify;

use std::path::{Path, PathBuf};

pub use blob::{Blob, hash_file};
pub use bundle::{ArchivedRun, Imported, Refusal};
pub use complete::CompleteRun;
pub use copies::PrivateCopy;
pub use digest::{Digest, Key, NotHex};
pub use folder::{Folder, FolderEntry, FolderFile, Part, hash_folder};
pub use history::History;
pub use in_use::{Hold, InUse};
pub use past::{PastRun, RunEnd, StageOfRun, StageState};
pub use record::{Fingerprint, Outputs, RECORD_VERSION, Record, RecordInput, RecordItem, Stored};
pub use run::Run;
pub use stats::Stats;
pub(crate) use stats::now;
pub use sweep::{Sweep, Swept};
pub use usage::Usage;
pub use verify::{Damage, Verified};

use crate::fsx::{self, Dir, Entry, FsError, Lock};

/// Why the store cannot be used.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum StoreError {
    /// A file of the store could not be read or written.
    #[error("{0}")]
    Fs(#[from] FsError),
    /// The store's path is not a folder.
    #[error("the store `{}` is not a folder", .0.display())]
    NotAFolder(PathBuf),
    /// The current folder, to which the store's path is relative, no longer exists.
    #[error("cannot locate the store `{path}`: {source}", path = path.display())]
    NoWorkingFolder {
        /// The path as given.
        path: PathBuf,
        /// The system's answer.
        source: std::io::Error,
    },
    /// The store's path is not UTF-8, so job files cannot contain it.
    #[error("the path of the store, `{}`, is not UTF-8, expected a path that job files can contain", .0.display())]
    NotText(PathBuf),
    /// Something is incomplete; the text says what.
    #[error("{0}")]
    NotWhole(String),
    /// A file from outside has changed since the run was planned.
    #[error("`{}` was changed after the run was planned; run again", .0.display())]
    Changed(PathBuf),
    /// Another machine removed what this run had found.
    #[error(
        "`cache gc` on another machine removed results that this run had found; run again to rebuild them"
    )]
    Collected,
    /// Another machine removed the private folder of this run.
    #[error(
        "this process gave no sign of life for {} min (it was suspended, or cut off from the file system of the store), so \
         another machine took it for dead and removed its unfinished work; run again to continue", fsx::RUN_PATIENCE.as_secs() / 60
    )]
    TakenForDead,
    /// Another process published a different result for the same work.
    #[error(
        "another process has stored a different result for the same work meanwhile (output `{0}`), so this stage is not \
         deterministic; the stored result was kept. See `run --check-determinism`"
    )]
    Differs(String),
    /// A blob that a stage needs is missing.
    #[error("the blob `{}` is no longer in the store; run again to rebuild it", .0.display())]
    Missing(PathBuf),
    /// A blob that a stage needs does not match its digest. It was moved to quarantine.
    #[error(
        "the blob `{}` is damaged and was moved to `quarantine-v1/` of the store; run again to rebuild it", .0.display()
    )]
    Damaged(PathBuf),
}

/// The folders of blobs and records.
const BLOBS: &str = "blobs-v1";
const RECORDS: &str = "records-v1";

/// Computes the key of a record; passed in, since the planner defines keys.
pub type KeyOf = fn(&Record) -> Option<Key>;

/// What the store has under a key.
#[derive(Clone, Debug, PartialEq)]
pub enum Found {
    /// The record.
    Record(Box<Record>),
    /// Nothing.
    Nothing,
    /// Not a valid record; the text says why.
    Damaged(String),
}

/// A store in a folder. Any number of processes may use one at the same time.
#[derive(Clone, Debug)]
pub struct Store {
    root: PathBuf,
    blobs: Dir,
    records: Dir,
}

impl Store {
    /// Opens the store in `root`. Writes nothing: the folder is created when something is stored.
    ///
    /// # Errors
    /// The path is not a folder.
    pub fn open(root: &Path) -> Result<Store, StoreError> {
        let absolute = std::path::absolute(root)
            .map_err(|source| StoreError::NoWorkingFolder { path: root.to_owned(), source })?;
        // A link to a folder is allowed.
        match fsx::entry(&absolute)? {
            Some(Entry::File(_)) => Err(StoreError::NotAFolder(absolute)),
            _ => {
                let (blobs, records) = (absolute.join(BLOBS), absolute.join(RECORDS));
                Ok(Self { root: absolute, blobs: Dir::new(blobs), records: Dir::new(records) })
            }
        }
    }

    /// Its folder, absolute.
    pub fn root(&self) -> &Path {
        &self.root
    }

    /// The record of a key; `None` where there is none or it cannot be read (see [`Store::find`]).
    pub fn record(&self, key: &Key) -> Result<Option<Record>, StoreError> {
        match self.find(key)? {
            Found::Record(record) => Ok(Some(*record)),
            Found::Nothing | Found::Damaged(_) => Ok(None),
        }
    }

    /// Looks a key up.
    pub fn find(&self, key: &Key) -> Result<Found, StoreError> {
        let Some(bytes) = fsx::read_if_there(&self.record_path(key))? else { return Ok(Found::Nothing) };
        Ok(match serde_json::from_slice::<Record>(&bytes) {
            Ok(record) if record.version == RECORD_VERSION => Found::Record(Box::new(record)),
            Ok(record) => {
                Found::Damaged(format!("it has version {}, expected {RECORD_VERSION}", record.version))
            }
            Err(error) => Found::Damaged(error.to_string()),
        })
    }

    /// True where the record file of a key exists. Cheaper than reading it.
    pub fn has_record(&self, key: &Key) -> Result<bool, StoreError> {
        Ok(matches!(self.records.entry(&sharded(&key.hex(), ".json"))?, Some(Entry::File(_))))
    }

    /// Makes sure that a record is seen that another machine has just written: network file systems remember for up to a minute that
    /// a file was not there.
    ///
    /// # Errors
    /// The store cannot be written.
    pub fn refresh(&self, key: &Key) -> Result<(), StoreError> {
        match self.record_path(key).parent() {
            Some(folder) => Ok(fsx::refresh(folder)?),
            None => Ok(()),
        }
    }

    /// The first output of which a file is missing or has the wrong length.
    pub fn lost<'o>(&self, outputs: &'o Outputs) -> Result<Option<&'o str>, StoreError> {
        for (name, stored) in outputs {
            if !self.has_blob(&stored.digest, stored.bytes)?
                || stored.folder && !self.has_folder(&stored.digest)?
            {
                return Ok(Some(name));
            }
        }
        Ok(None)
    }

    /// True where a blob with this length exists. Its bytes are not read.
    fn has_blob(&self, digest: &Digest, bytes: u64) -> Result<bool, StoreError> {
        Ok(self.blobs.entry(&sharded(&digest.hex(), ""))? == Some(Entry::File(bytes)))
    }

    /// The path of a blob (a read-only file); it may not exist.
    pub fn blob_path(&self, digest: &Digest) -> PathBuf {
        self.blobs.path().join(sharded(&digest.hex(), ""))
    }

    /// The path of a key's record; it may not exist.
    pub fn record_path(&self, key: &Key) -> PathBuf {
        self.records.path().join(sharded(&key.hex(), ".json"))
    }

    /// The folder of a key's checkpoints; it may not exist.
    pub fn checkpoints(&self, key: &Key) -> PathBuf {
        self.root.join("checkpoints-v1").join(key.hex())
    }

    /// Removes a key's checkpoints by moving them into `folder`, which is private to the caller and in this store.
    ///
    /// # Errors
    /// They exist and can be neither moved nor removed.
    pub fn clear_checkpoints(&self, key: &Key, folder: &Path) -> Result<(), StoreError> {
        let checkpoints = self.checkpoints(key);
        match fsx::rename(&checkpoints, &folder.join("checkpoints")) {
            Err(error) if !error.is_not_found() => Ok(fsx::remove_dir_all(&checkpoints)?),
            _ => Ok(()),
        }
    }

    /// Takes the lock on a key, the exclusive right to write its record; `None` while another process holds it. Needs a
    /// [`Run`], which creates the folder.
    ///
    /// # Errors
    /// The store cannot be written, or its file system knows no locks.
    pub fn try_lock(&self, key: &Key) -> Result<Option<Lock>, StoreError> {
        Ok(Lock::try_acquire(&self.root.join("locks-v1").join(key.hex()))?)
    }

    /// Commits the result of a key: its blobs become durable, then the record is written. `folder` is private to the caller and
    /// in this store.
    ///
    /// # Errors
    /// The store cannot be written; then there is no record.
    pub fn commit(
        &self,
        key: &Key,
        record: &Record,
        blobs: &[Blob],
        folder: &Path,
    ) -> Result<(), StoreError> {
        for blob in blobs {
            blob.sync()?;
        }
        let draft = folder.join("record.json");
        let path = self.record_path(key);
        fsx::write_synced(&draft, &serde_json::to_vec(record).map_err(in_memory(&draft))?)?;
        Ok(place(&draft, &path)?)
    }
}

/// `name` in a subfolder named after its first two characters, so that no folder gets too large.
fn sharded(name: &str, ending: &str) -> String {
    let (shard, rest) = name.split_at(2);
    let mut path = String::with_capacity(name.len() + ending.len() + 1);
    path.extend([shard, "/", rest, ending]);
    path
}

/// Moves a file to its final place and makes the name durable.
fn place(from: &Path, to: &Path) -> fsx::Result<()> {
    let made = fsx::rename_into(from, to)?;
    if let Some(folder) = to.parent() {
        fsx::sync_dir(folder)?;
        if let Some(above) = folder.parent().filter(|_| made) {
            fsx::sync_dir(above)?;
        }
    }
    Ok(())
}

/// Serialising to memory fails only for a number that is not finite; the message still names the file.
fn in_memory(path: &Path) -> impl FnOnce(serde_json::Error) -> FsError {
    let path = path.to_owned();
    move |error| FsError { action: "write", path, source: error.into() }
}

#[cfg(test)]
#[path = "store_tests.rs"]
mod tests;
