//! Fault injection for tests: every step that touches the disk can be listed, kill the process, or simulate a full disk from then
//! on; and a process can act as if it ran on another machine. Empty in release builds.

#[cfg(debug_assertions)]
mod armed {
    use std::path::{Path, PathBuf};
    use std::sync::atomic::{AtomicU64, Ordering};
    use std::sync::{Mutex, OnceLock};
    use std::time::Duration;

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

    /// From the `nth` step (from 1) on, writing finds the disk full. What needs no space continues to work.
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

    /// Another machine, whose kernel locks are not seen by others.
    static MACHINE: OnceLock<Machine> = OnceLock::new();

    /// A machine that a test makes up.
    #[derive(Clone, Debug)]
    pub struct Machine {
        /// Its name: processes with the same one are on the same machine.
        pub name: String,
        /// The folder of its kernel locks; `None` where the file system has none.
        pub locks: Option<PathBuf>,
        /// How long a lease is held without a sign of life.
        pub patience: Duration,
    }

    /// From now on, this process acts as if it ran on that machine. Call it first.
    pub fn run_on(machine: Machine) {
        let _ = MACHINE.set(machine);
    }

    pub(in crate::fsx) fn host() -> Option<String> {
        MACHINE.get().map(|machine| machine.name.clone())
    }

    pub(in crate::fsx) fn patience(usual: Duration) -> Duration {
        MACHINE.get().map_or(usual, |machine| machine.patience)
    }

    /// The file of the kernel lock that belongs to `path`; `None` where there are no kernel locks.
    pub(in crate::fsx) fn kernel_lock(path: &Path) -> Option<PathBuf> {
        let Some(machine) = MACHINE.get() else { return Some(path.to_owned()) };
        let folder = machine.locks.as_ref()?;
        let name: String =
            path.as_os_str().as_encoded_bytes().iter().map(|byte| format!("{byte:02x}")).collect();
        let file = folder.join(&name[name.len().saturating_sub(200)..]);
        let _ = std::fs::OpenOptions::new().append(true).create(true).open(&file);
        Some(file)
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
pub use armed::{Machine, arm, fill, run_on, seen, watch};
#[cfg(debug_assertions)]
pub(super) use armed::{host, kernel_lock, patience, step};

/// A step that touches the disk.
#[cfg(not(debug_assertions))]
#[inline(always)]
pub(super) fn step(_: &'static str, _: &std::path::Path) -> super::Result<()> {
    Ok(())
}

/// How long a lease is held without a sign of life, where it is `usual` that long.
#[cfg(not(debug_assertions))]
#[inline(always)]
pub(super) fn patience(usual: std::time::Duration) -> std::time::Duration {
    usual
}

/// The file of the kernel lock that belongs to `path`.
#[cfg(not(debug_assertions))]
#[inline(always)]
pub(super) fn kernel_lock(path: &std::path::Path) -> Option<std::path::PathBuf> {
    Some(path.to_owned())
}
