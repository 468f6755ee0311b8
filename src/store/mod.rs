//! The content-addressed store: blobs by the name of their content, records by the key of the work that made them.
//! A record is written last, so a crash leaves garbage and never half a result. See `docs/design/store.md`.

mod digest;
mod record;

use std::path::{Path, PathBuf};

pub use digest::{Digest, Key, NotHex};
pub use record::{Fingerprint, Outputs, RECORD_VERSION, Record, RecordInput, RecordItem, Stored};

use crate::fsx::FsError;

/// Why the store cannot be used.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum StoreError {
    /// A file of the store could not be read or written.
    #[error("{0}")]
    Fs(#[from] FsError),
}

/// A store in a folder. Any number of processes may use one at the same time.
#[derive(Clone, Debug)]
pub struct Store {
    root: PathBuf,
}

impl Store {
    /// Opens the store in `root`, making the folder where there is none.
    ///
    /// # Errors
    /// The folder cannot be made or is not a folder.
    pub fn open(root: &Path) -> Result<Store, StoreError> {
        Ok(Self { root: root.to_owned() })
    }

    /// Its folder, absolute.
    pub fn root(&self) -> &Path {
        &self.root
    }

    /// The record of a key; `None` where that work was never finished here.
    ///
    /// # Errors
    /// The store cannot be read.
    pub fn record(&self, key: &Key) -> Result<Option<Record>, StoreError> {
        let _ = key;
        Ok(None)
    }

    /// The file of a content (read-only); it may not be there.
    pub fn blob_path(&self, digest: &Digest) -> PathBuf {
        let hex = digest.hex();
        self.root.join("blobs-v1").join(&hex[..2]).join(&hex[2..])
    }
}
