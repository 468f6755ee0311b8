//! What living runs use, so that nobody removes it under their hands.
//!
//! A run lists the keys and contents that it relies on in `tmp/<run>/uses`. Whoever looks something up that has to stay,
//! and notes it there, holds the shared lock on `gc.lock` meanwhile; whoever removes something holds it alone. So what a
//! run found is either noted before anything is removed, or gone before it was found.

use std::collections::HashSet;

use super::{Digest, Key, Run, Store, StoreError};
use crate::fsx::{self, Lock};

/// What living runs rely on.
#[derive(Clone, Debug, Default)]
pub struct InUse {
    /// Their names.
    pub runs: Vec<String>,
    /// Keys whose records they found, or make.
    pub keys: HashSet<Key>,
    /// Contents that they read or have just made.
    pub digests: HashSet<Digest>,
}

impl Store {
    /// Keeps others from removing anything until the lock is dropped; `None` where nobody ever ran on this store. Waits
    /// while somebody removes things. Makes no file, so that a store that can only be read can be used.
    ///
    /// # Errors
    /// The lock cannot be opened, or the file system knows no locks.
    pub fn hold(&self) -> Result<Option<Lock>, StoreError> {
        Ok(Lock::shared(&self.root().join("gc.lock"))?)
    }

    /// The right to remove things. Waits until nobody looks anything up.
    ///
    /// # Errors
    /// The store cannot be written.
    pub(super) fn hold_alone(&self) -> Result<Lock, StoreError> {
        Ok(Lock::acquire(&self.root().join("gc.lock"))?)
    }

    /// What living runs rely on. A run that is about to die counts as living.
    ///
    /// # Errors
    /// The store cannot be read.
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
    /// Notes that this run relies on the records of these keys, and on these contents, until it ends. The caller
    /// [holds](Store::hold) the store since before it found them.
    ///
    /// # Errors
    /// The note cannot be written.
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
