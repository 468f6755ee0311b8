//! Leases: locks that hold across machines, with nothing but what every shared file system gives: one of two that create the same
//! file gets it, and the server stamps a file that changes.
//!
//! A lease is a file that names its owner. The owner [touches](super::heartbeat) it as long as it lives; a lease that was not
//! touched for its `patience`, by the clock of the file server, belongs to nobody any more. What follows from this, and what does
//! not, is in `docs/design/store.md`.

use std::fs::OpenOptions;
use std::io::{self, Write};
use std::os::unix::fs::MetadataExt;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};
use std::time::{Duration, SystemTime, UNIX_EPOCH};

use super::fault::step;
use super::heartbeat::{self, Beat};
use super::host::{self, Host};
use super::lease_file::{FORMAT, Seen, WORK, folder};
use super::{FsError, Result, clock};

/// How many takers may die one after another while they take a lease over.
const DEEPEST: u32 = 8;

/// A lease that this process holds until it is dropped.
#[derive(Debug)]
pub(super) struct Lease {
    beat: Arc<Beat>,
    patience: Duration,
}

impl Lease {
    /// Takes the lease at `path`; `None` while somebody holds it. `alone` is true where the caller has the kernel lock that
    /// belongs to it: then no other process of this machine holds the lease, whatever the file says.
    ///
    /// # Errors
    /// The folder cannot be written.
    pub fn take(path: &Path, patience: Duration, alone: bool) -> Result<Option<Self>> {
        take(path, patience, alone, 0)
    }

    /// True while this process still owns the lease. It may have lost it after it stood still for longer than its patience.
    ///
    /// # Errors
    /// The file exists and cannot be read.
    pub fn is_ours(&self) -> Result<bool> {
        Ok(!self.beat.is_lost()
            && Seen::at(&self.beat.path)?.is_some_and(|seen| seen.text() == self.beat.text))
    }

    /// True where the lease is so young that nobody takes it over soon.
    fn is_fresh(&self) -> bool {
        !self.beat.is_lost() && self.beat.age() < self.patience / 2
    }

    /// Touches `path` whenever the lease is touched.
    pub fn touch_also(&self, path: PathBuf) {
        self.beat.touch_also(path);
    }

    /// Calls `act` in another thread as soon as this process notices that it has lost the lease.
    pub fn on_loss(&self, act: fn()) {
        self.beat.on_loss(act);
    }

    /// What the lease says: unique to it.
    pub fn text(&self) -> &str {
        &self.beat.text
    }
}

impl Drop for Lease {
    fn drop(&mut self) {
        heartbeat::end(&self.beat);
        if !self.is_ours().unwrap_or(true) {
            return;
        }
        let _ = if self.is_fresh() {
            super::remove_file(&self.beat.path).map(drop)
        } else {
            // Somebody may be taking it over at this moment.
            let seen = Seen::of(&self.beat.text);
            remove(&self.beat.path, &seen, false, 0).map(drop)
        };
    }
}

fn take(path: &Path, patience: Duration, alone: bool, depth: u32) -> Result<Option<Lease>> {
    loop {
        if let Some(lease) = create(path, patience)? {
            return Ok(Some(lease));
        }
        let Some(other) = Seen::at(path)? else { continue };
        if depth == DEEPEST || other.is_held(path, alone) || !remove(path, &other, alone, depth)? {
            return Ok(None);
        }
    }
}

/// Removes a lease that nobody holds any more, and no other one: false where somebody else is doing that.
///
/// Two that see the same dead lease must not both remove what is at the path, since the second one would remove the new lease of
/// the first. So there is a lease of its own on the right to remove *this* one, whose text never comes again.
fn remove(path: &Path, other: &Seen, alone: bool, depth: u32) -> Result<bool> {
    let Some(right) = take(&other.right_to_remove(path), super::fault::patience(WORK), alone, depth + 1)?
    else {
        return Ok(false);
    };
    if Seen::at(path)?.is_some_and(|now| now.text() == other.text()) {
        super::remove_file(path)?;
    }
    drop(right);
    Ok(true)
}

/// Makes the lease where there is none; `None` where there is one.
fn create(path: &Path, patience: Duration) -> Result<Option<Lease>> {
    static COUNT: AtomicU64 = AtomicU64::new(0);
    step("write", path)?;
    let began = clock::since_boot();
    let (host, process) = (host::this(), std::process::id());
    let time = SystemTime::now().duration_since(UNIX_EPOCH).unwrap_or_default().as_nanos();
    let number = COUNT.fetch_add(1, Ordering::Relaxed);
    // Of the folder: some file systems give each file a device of its own.
    let device = std::fs::metadata(folder(path)).map_err(FsError::at("access", path))?.dev();
    let (millis, Host { boot, name }) = (patience.as_millis(), host);
    let text =
        format!("{FORMAT} {millis} {boot}:{device} {name} {process} {process:x}-{time:x}-{number:x}\n");
    if !place(path, &text)? {
        return Ok(None);
    }
    // A process suspended in between may have been taken for dead.
    let is_late = clock::since_boot().saturating_sub(began) > 1000;
    if is_late && Seen::at(path)?.is_none_or(|seen| seen.text() != text) {
        return Ok(None);
    }
    let beat = heartbeat::begin(path.to_owned(), text, began, patience);
    Ok(Some(Lease { beat, patience }))
}

/// Puts a file with this text at `path`; false where there is one. It appears with its text, so that a process that is killed
/// leaves no lease without an owner: it is written beside its place, and linked there.
fn place(path: &Path, text: &str) -> Result<bool> {
    if std::fs::symlink_metadata(path).is_ok() {
        return Ok(false);
    }
    let name = text.trim_end().rsplit(' ').next().unwrap_or_default();
    let mut draft = path.as_os_str().to_owned();
    draft.push(format!(".{name}.new"));
    let draft = PathBuf::from(draft);
    write_new(&draft, text)?;
    let linked = std::fs::hard_link(&draft, path);
    let _ = std::fs::remove_file(&draft);
    match linked {
        Ok(()) => Ok(true),
        // A file server that answers twice says so of the link that it has made itself.
        Err(error) if error.kind() == io::ErrorKind::AlreadyExists => {
            Ok(Seen::at(path)?.is_some_and(|seen| seen.text() == text))
        }
        // There are no hard links here.
        Err(_) => match write_new(path, text) {
            Err(error) if error.source.kind() == io::ErrorKind::AlreadyExists => Ok(false),
            written => written.map(|()| true),
        },
    }
}

fn write_new(path: &Path, text: &str) -> Result<()> {
    let file = OpenOptions::new().write(true).create_new(true).open(path);
    let mut file = file.map_err(FsError::at("make the lease", path))?;
    file.write_all(text.as_bytes()).map_err(|error| {
        // A lease without an owner would be held until it is old.
        let _ = std::fs::remove_file(path);
        FsError::at("write", path)(error)
    })
}

#[cfg(test)]
mod tests {
    use std::sync::atomic::AtomicUsize;

    use super::*;

    /// A lease of a process that died long ago on another machine.
    fn dead(path: &Path, name: &str) {
        let text = format!("{FORMAT} 60000 other-boot:1 other-host 7 {name}\n");
        std::fs::write(path, text).unwrap();
        let long_ago = SystemTime::now() - Duration::from_secs(3600);
        std::fs::File::options().append(true).open(path).unwrap().set_modified(long_ago).unwrap();
    }

    #[test]
    fn a_lease_is_held_by_one_and_free_once_dropped() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("lease");
        let first = Lease::take(&path, WORK, false).unwrap().unwrap();
        assert!(first.is_ours().unwrap() && Lease::take(&path, WORK, false).unwrap().is_none());
        drop(first);
        assert!(Lease::take(&path, WORK, false).unwrap().is_some());
        assert_eq!(crate::fsx::list(folder.path()).unwrap(), [] as [PathBuf; 0]);
    }

    #[test]
    fn a_lease_of_another_machine_is_held_while_it_is_young_and_one_of_a_dead_process_here_is_not() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("lease");
        std::fs::write(&path, format!("{FORMAT} 60000 other-boot:1 other-host 7 name\n")).unwrap();
        for alone in [false, true] {
            assert!(Lease::take(&path, WORK, alone).unwrap().is_none());
        }
        std::mem::forget(Lease::take(&folder.path().join("here"), WORK, true).unwrap().unwrap());
        assert!(Lease::take(&folder.path().join("here"), WORK, false).unwrap().is_none());
        assert!(Lease::take(&folder.path().join("here"), WORK, true).unwrap().is_some());
        // Nobody knows whose this is, so its age decides.
        std::fs::write(folder.path().join("half"), b"").unwrap();
        assert!(Lease::take(&folder.path().join("half"), WORK, true).unwrap().is_none());
    }

    #[test]
    fn of_many_that_take_a_dead_lease_over_one_wins() {
        let folder = tempfile::tempdir().unwrap();
        for round in 0..40 {
            let path = folder.path().join(format!("{round}"));
            dead(&path, &format!("name-{round}"));
            let (held, most, winners) = (AtomicUsize::new(0), AtomicUsize::new(0), AtomicUsize::new(0));
            std::thread::scope(|scope| {
                for _ in 0..8 {
                    scope.spawn(|| {
                        // Who comes too late finds it held or, once it was dropped, free.
                        for _ in 0..20 {
                            let Some(lease) = Lease::take(&path, WORK, false).unwrap() else { continue };
                            most.fetch_max(held.fetch_add(1, Ordering::SeqCst) + 1, Ordering::SeqCst);
                            assert!(lease.is_ours().unwrap());
                            winners.fetch_add(1, Ordering::SeqCst);
                            held.fetch_sub(1, Ordering::SeqCst);
                        }
                    });
                }
            });
            assert_eq!(most.into_inner(), 1);
            assert!(winners.into_inner() > 0 && Seen::at(&path).unwrap().is_none());
        }
        assert_eq!(crate::fsx::list(folder.path()).unwrap(), [] as [PathBuf; 0]);
    }

    #[test]
    fn a_lease_that_was_taken_over_is_noticed_and_not_removed_by_its_old_owner() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("lease");
        let lost = Lease::take(&path, WORK, false).unwrap().unwrap();
        dead(&path, "another");
        assert!(!lost.is_ours().unwrap());
        drop(lost);
        assert!(Seen::at(&path).unwrap().unwrap().text().ends_with("another\n"));
    }
}
