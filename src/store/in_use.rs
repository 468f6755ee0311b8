//! What running processes use, so that `gc` does not remove it.
//!
//! A run lists the keys and blobs that it relies on in `tmp/<run>/uses`. While it looks something up and adds it to the list, it
//! holds the shared lock on `gc.lock`; `gc` holds it exclusively. So what a run found is either listed before anything is removed,
//! or removed before it was found.

use std::collections::HashSet;

use super::{Digest, Key, Run, Store, StoreError};
use crate::fsx::{self, Lock};

/// What current runs rely on.
#[derive(Clone, Debug, Default)]
pub struct InUse {
    /// Their names.
    pub runs: Vec<String>,
    /// Keys whose records they found or build.
    pub keys: HashSet<Key>,
    /// Blobs that they read or have just built.
    pub digests: HashSet<Digest>,
}

impl Store {
    /// Keeps `gc` out until the lock is dropped; `None` where there was never a run on this store. Waits for a running `gc`.
    /// Creates no file, so that a read-only store can be used.
    ///
    /// # Errors
    /// The lock cannot be opened, or the file system does not support locks.
    pub fn hold(&self) -> Result<Option<Lock>, StoreError> {
        Ok(Lock::shared(&self.root().join("gc.lock"))?)
    }

    /// The exclusive lock of `gc`. Waits until no process looks anything up.
    pub(super) fn hold_alone(&self) -> Result<Lock, StoreError> {
        Ok(Lock::acquire(&self.root().join("gc.lock"))?)
    }

    /// What current runs rely on. A run that is about to die counts as living.
    pub fn in_use(&self) -> Result<InUse, StoreError> {
        let mut all = InUse::default();
        for path in fsx::list(&self.root().join("tmp"))? {
            let Some(id) = path.file_name().and_then(|name| name.to_str()) else { continue };
            if id.ends_with(".lock") || id == "gate" || !self.is_alive(id) {
                continue;
            }
            all.runs.push(id.to_owned());
            for line in
                fsx::read_if_there(&path.join("uses"))?.unwrap_or_default().split(|byte| *byte == b'\n')
            {
                let Ok(line) = std::str::from_utf8(line) else { continue };
                match line.split_once(' ') {
                    Some(("key", key)) => all.keys.extend(key.parse::<Key>()),
                    Some(("content", digest)) => all.digests.extend(digest.parse::<Digest>()),
                    _ => {}
                }
            }
        }
        Ok(all)
    }
}

impl Run {
    /// Protects the records of these keys and these blobs from `gc` until this run ends. The caller must have
    /// [held](Store::hold) the store since before it found them.
    pub fn rely_on(
        &self,
        keys: impl IntoIterator<Item = Key>,
        digests: impl IntoIterator<Item = Digest>,
    ) -> Result<(), StoreError> {
        let mut lines = String::new();
        for key in keys {
            lines.extend(["key ", &key.hex(), "\n"]);
        }
        for digest in digests {
            lines.extend(["content ", &digest.hex(), "\n"]);
        }
        Ok(fsx::append(&self.temporary().join("uses"), lines.as_bytes())?)
    }
}
