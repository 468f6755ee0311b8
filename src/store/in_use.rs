//! What running processes use, so that `gc` does not remove it.
//!
//! A run lists the keys and blobs that it relies on in `tmp/<run>/uses`, and `gc` announces itself in `gc.lock`. A run first lists,
//! then looks whether `gc` is running (and waits until it is not), then looks the result up; `gc` first announces itself, then reads
//! the lists, then removes. So at least one of the two sees the other, on whatever machines they run. On one machine the kernel's
//! lock on `gc.lock` makes each wait for the other: runs hold it in shared mode while they look something up, `gc` exclusively.

use std::collections::HashSet;
use std::time::Duration;

use super::{Digest, Key, Run, Store, StoreError};
use crate::fsx::{self, Lock};

/// Pause between two looks at a `gc` on another machine.
const PAUSE: Duration = Duration::from_millis(100);

/// Keeps `gc` out: on this machine while it exists, on others for what was [relied on](Run::rely_on) before.
#[derive(Debug)]
pub struct Hold {
    _lock: Lock,
    /// What `gc.lock` says. It is never the same again after a `gc` on another machine.
    seen: String,
}

/// The right of `gc` to remove things.
#[derive(Debug)]
pub(super) struct Alone {
    lock: Lock,
    path: std::path::PathBuf,
}

impl Drop for Alone {
    fn drop(&mut self) {
        // Where this fails, others wait until there was no sign of life for a while.
        let _ = self.lock.end_announcement(&self.path);
    }
}

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
    /// Keeps `gc` out; `None` where there was never a run on this store. Waits for a running `gc`. Creates no file, so that a
    /// read-only store can be used. What is looked up must be [relied on](Run::rely_on) before: see [`Hold`].
    ///
    /// # Errors
    /// The lock cannot be opened.
    pub fn hold(&self) -> Result<Option<Hold>, StoreError> {
        let path = self.gc_lock();
        let Some(lock) = Lock::shared(&path)? else { return Ok(None) };
        loop {
            let (seen, running) = fsx::announced(&path)?;
            if !running {
                return Ok(Some(Hold { _lock: lock, seen }));
            }
            std::thread::sleep(PAUSE);
        }
    }

    /// True where no `gc` on another machine has begun since `held` was taken (`None`: since before there was a lock).
    ///
    /// # Errors
    /// The lock cannot be read.
    pub fn is_undisturbed(&self, held: Option<&Hold>) -> Result<bool, StoreError> {
        Ok(fsx::announced(&self.gc_lock())?.0 == held.map_or("", |held| &held.seen))
    }

    /// The right to remove things. Waits until no process of this machine looks anything up.
    pub(super) fn hold_alone(&self) -> Result<Alone, StoreError> {
        let path = self.gc_lock();
        let lock = Lock::acquire(&path)?;
        lock.announce(&path)?;
        Ok(Alone { lock, path })
    }

    fn gc_lock(&self) -> std::path::PathBuf {
        self.root().join("gc.lock")
    }

    /// What current runs rely on. A run that is about to die counts as living.
    pub fn in_use(&self) -> Result<InUse, StoreError> {
        let mut all = InUse::default();
        for path in fsx::list(&self.root().join("tmp"))? {
            let Some(id) = path.file_name().and_then(|name| name.to_str()) else { continue };
            if id.contains('.') || id == "gate" || !self.is_alive(id) {
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
    /// Protects the records of these keys and these blobs from `gc` until this run ends. The caller looks them up, or makes them,
    /// only after this, and [holds](Store::hold) the store meanwhile.
    ///
    /// # Errors
    /// The list cannot be written, or another machine took this process for dead and removed it.
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
        match fsx::append(&self.temporary().join("uses"), lines.as_bytes()) {
            Err(error) if error.is_not_found() => Err(StoreError::TakenForDead),
            result => Ok(result?),
        }
    }
}
