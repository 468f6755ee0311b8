//! Fault injection for tests: every step that touches the disk can be listed, kill the process, or simulate a full disk from then
//! on. Empty in release builds.

#[cfg(debug_assertions)]
mod armed {
    use std::path::{Path, PathBuf};
    use std::sync::Mutex;
    use std::sync::atomic::{AtomicU64, Ordering};

    use crate::fsx::{FsError, Result};

    /// Steps still to pass; 0 is "not armed".
    static LEFT: AtomicU64 = AtomicU64::new(0);
    /// Steps until the disk is full; 0 is "never", 1 is "full".
    static ROOM: AtomicU64 = AtomicU64::new(0);
    /// The steps since [`watch`].
    static SEEN: Mutex<Option<Vec<(&'static str, PathBuf)>>> = Mutex::new(None);

    /// Kills this process, as `kill -9` would, when it comes to the `nth` step (from 1).
    pub fn arm(nth: u64) {
        LEFT.store(nth, Ordering::SeqCst);
    }

    /// From the `nth` step (from 1) on, writing finds the disk full. What needs no room goes on working.
    pub fn fill(nth: u64) {
        ROOM.store(nth, Ordering::SeqCst);
    }

    /// Begins to list steps.
    pub fn watch() {
        if let Ok(mut seen) = SEEN.lock() {
            seen.get_or_insert_default();
        }
    }

    /// The steps on paths below `root` since [`watch`]: what was to be done, and on what.
    pub fn seen(root: &Path) -> Vec<(&'static str, PathBuf)> {
        let seen = SEEN.lock().ok().and_then(|seen| seen.clone()).unwrap_or_default();
        seen.into_iter().filter(|(_, path)| path.starts_with(root)).collect()
    }

    pub(in crate::fsx) fn step(what: &'static str, path: &Path) -> Result<()> {
        if let Ok(mut seen) = SEEN.lock()
            && let Some(seen) = seen.as_mut()
        {
            seen.push((what, path.to_owned()));
        }
        let counted = LEFT.fetch_update(Ordering::SeqCst, Ordering::SeqCst, |left| left.checked_sub(1));
        if counted == Ok(1) {
            let _ = rustix::process::kill_process(rustix::process::getpid(), rustix::process::Signal::KILL);
            std::process::abort();
        }
        let room = ROOM.fetch_update(Ordering::SeqCst, Ordering::SeqCst, |room| (room > 1).then(|| room - 1));
        if room == Err(1) && ["append", "make", "write", "half", "sync"].contains(&what) {
            return Err(FsError::at("write", path)(rustix::io::Errno::NOSPC.into()));
        }
        Ok(())
    }
}

#[cfg(debug_assertions)]
pub(super) use armed::step;
#[cfg(debug_assertions)]
pub use armed::{arm, fill, seen, watch};

/// A step that touches the disk.
#[cfg(not(debug_assertions))]
#[inline(always)]
pub(super) fn step(_: &'static str, _: &std::path::Path) -> super::Result<()> {
    Ok(())
}
