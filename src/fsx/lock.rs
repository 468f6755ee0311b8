//! Locks between processes, on this machine and on others.
//!
//! A lock is two things: a kernel lock on the file at its path, which disappears with its owner at once and has no content that
//! could be corrupted; and a [lease](super::lease) beside it, for the processes of other machines, whose kernel locks may not be
//! seen here. Who holds the kernel lock knows that a lease of this machine belongs to a dead process. Where a file system has no
//! kernel locks, the lease alone decides.

use std::fs::{File, OpenOptions, TryLockError};
use std::io;
use std::os::unix::fs::MetadataExt;
use std::path::{Path, PathBuf};
use std::time::Duration;

use rustix::io::Errno;

use super::lease::Lease;
use super::lease_file::{RUN, Seen, WORK};
use super::{FsError, Result, fault};

/// The ending of a lease's file, after the name of the lock.
const LEASE: &str = ".lease";
/// Shortest and longest pause between two looks at a lease that another machine holds.
const PAUSES: (Duration, Duration) = (Duration::from_millis(5), Duration::from_millis(250));

/// A lock that this process holds until it is dropped.
#[derive(Debug)]
pub struct Lock {
    // Before the kernel lock, whose release ends the lock on this machine.
    lease: Option<Lease>,
    kernel: Kernel,
    path: PathBuf,
}

impl Lock {
    /// Takes the lock on `path` (a lock file, which is created if needed); `None` while another process holds it.
    ///
    /// # Errors
    /// A file cannot be created.
    pub fn try_acquire(path: &Path) -> Result<Option<Self>> {
        Self::try_acquire_for(path, WORK)
    }

    /// As [`Lock::try_acquire`], for the lock of a run: other machines believe it alive for longer when they see no sign of life.
    ///
    /// # Errors
    /// As [`Lock::try_acquire`].
    pub fn try_acquire_run(path: &Path) -> Result<Option<Self>> {
        Self::try_acquire_for(path, RUN)
    }

    fn try_acquire_for(path: &Path, patience: Duration) -> Result<Option<Self>> {
        loop {
            let Some(kernel) = Kernel::try_exclusive(path)? else { return Ok(None) };
            match Self::with(kernel, path, patience)? {
                Taken::Ours(lock) => return Ok(Some(lock)),
                Taken::Elsewhere => return Ok(None),
                Taken::Again => {}
            }
        }
    }

    /// Takes the lock on `path`; waits while another process holds it.
    ///
    /// # Errors
    /// As [`Lock::try_acquire`].
    pub fn acquire(path: &Path) -> Result<Self> {
        let mut pause = PAUSES.0;
        loop {
            match Self::with(Kernel::exclusive(path)?, path, WORK)? {
                Taken::Ours(lock) => return Ok(lock),
                Taken::Elsewhere => {
                    std::thread::sleep(pause);
                    pause = (pause * 2).min(PAUSES.1);
                }
                Taken::Again => {}
            }
        }
    }

    /// Takes the lease that belongs to a kernel lock.
    fn with(kernel: Kernel, path: &Path, patience: Duration) -> Result<Taken> {
        if !kernel.is_at_its_path()? {
            return Ok(Taken::Again);
        }
        match Lease::take(&beside(path), fault::patience(patience), kernel.works)? {
            None => Ok(Taken::Elsewhere),
            // Another machine may have removed the file before it released the lease.
            Some(lease) if kernel.is_at_its_path()? => {
                Ok(Taken::Ours(Self { lease: Some(lease), kernel, path: path.to_owned() }))
            }
            Some(_) => Ok(Taken::Again),
        }
    }

    /// Takes the lock on `path` in shared mode, which excludes exclusive holders on this machine only; waits for them. `None`
    /// where there is no such file.
    ///
    /// # Errors
    /// The file exists and cannot be opened.
    pub fn shared(path: &Path) -> Result<Option<Self>> {
        let Some(kernel) = Kernel::shared(path)? else { return Ok(None) };
        Ok(Some(Self { lease: None, kernel, path: path.to_owned() }))
    }

    /// True while the lock on `path` is held, here or elsewhere. Creates no lock file.
    ///
    /// # Errors
    /// A file exists and cannot be opened.
    pub fn is_held(path: &Path) -> Result<bool> {
        let works = match Kernel::is_held(path)? {
            Some(true) => return Ok(true),
            Some(false) => true,
            None => false,
        };
        let path = beside(path);
        Ok(Seen::at(&path)?.is_some_and(|seen| seen.is_held(&path, works)))
    }

    /// The name of the other machine that holds the lock on `path`; `None` where it is free or held on this one.
    ///
    /// # Errors
    /// A file exists and cannot be opened.
    pub fn other_machine(path: &Path) -> Result<Option<String>> {
        let path = beside(path);
        Ok(Seen::at(&path)?
            .filter(|seen| seen.is_held(&path, true))
            .and_then(|seen| seen.host().map(str::to_owned)))
    }

    /// False where this process stood still for so long (it was suspended, or its machine was cut off from the file system) that
    /// another machine has taken the lock over.
    ///
    /// # Errors
    /// The lease exists and cannot be read.
    pub fn is_ours(&self) -> Result<bool> {
        self.lease.as_ref().map_or(Ok(true), Lease::is_ours)
    }

    /// Calls `act`, in another thread, as soon as this process notices that it has lost the lock.
    pub fn on_loss(&self, act: fn()) {
        if let Some(lease) = &self.lease {
            lease.on_loss(act);
        }
    }

    /// Writes the lease to `path`, in place, and touches that file as often as the lease, until [`Lock::end_announcement`]: for
    /// those who look there with [`announced`].
    ///
    /// # Errors
    /// The file cannot be written.
    pub fn announce(&self, path: &Path) -> Result<()> {
        let Some(lease) = &self.lease else { return Ok(()) };
        super::overwrite(path, lease.text().as_bytes())?;
        lease.touch_also(path.to_owned());
        Ok(())
    }

    /// Ends an announcement: what is then in the file is different from what was there before and while it was announced.
    ///
    /// # Errors
    /// The file cannot be written.
    pub fn end_announcement(&self, path: &Path) -> Result<()> {
        let Some(lease) = &self.lease else { return Ok(()) };
        super::overwrite(path, format!("idle since {}", lease.text()).as_bytes())
    }

    /// Releases the lock and removes its file, so that lock files do not pile up. A waiting process creates a new one.
    ///
    /// # Errors
    /// The file cannot be removed; the lock is released all the same.
    pub fn remove(self) -> Result<()> {
        // Removed while the lock is held: a process that opened the file before notices, once it has the lock, that it is no longer
        // the file at the path, and tries again. So the lease ends after the file.
        if !self.is_ours()? {
            return Ok(());
        }
        super::remove_file(&self.kernel.path).map(drop)
    }

    /// The lock file as an empty stdin for a new process: the kernel lock is held until that process and all that inherit its
    /// stdin are gone, even if this one dies.
    ///
    /// # Errors
    /// There is no file descriptor left.
    pub fn as_input(&self) -> io::Result<File> {
        self.kernel.file.set_len(0)?;
        self.kernel.file.try_clone()
    }

    /// Its file.
    pub fn path(&self) -> &Path {
        &self.path
    }
}

/// What came of taking a lease.
enum Taken {
    Ours(Lock),
    /// Another machine has it.
    Elsewhere,
    /// The lock file was removed meanwhile.
    Again,
}

/// The lease that belongs to a lock.
fn beside(path: &Path) -> PathBuf {
    let mut lease = path.as_os_str().to_owned();
    lease.push(LEASE);
    lease.into()
}

/// What an exclusive holder of a lock on another machine announces in the file at `path`: its content, which differs before,
/// during and after; and true while the holder lives. The caller must have the shared lock on it.
///
/// # Errors
/// The file exists and cannot be read.
pub fn announced(path: &Path) -> Result<(String, bool)> {
    let Some(seen) = Seen::at(path)? else { return Ok((String::new(), false)) };
    let held = seen.host().is_some() && seen.is_held(path, true);
    Ok((seen.into_text(), held))
}

/// The kernel lock of a lock.
#[derive(Debug)]
struct Kernel {
    file: File,
    path: PathBuf,
    /// False where the file system has no kernel locks.
    works: bool,
}

impl Kernel {
    fn open(path: &Path, options: &OpenOptions) -> Result<Option<Self>> {
        let place = fault::kernel_lock(path);
        let (works, path) = (place.is_some(), place.unwrap_or_else(|| path.to_owned()));
        let file = super::if_there("open the lock", &path, options.open(&path))?;
        Ok(file.map(|file| Self { file, path, works }))
    }

    fn create(path: &Path) -> Result<Self> {
        let mut options = OpenOptions::new();
        options.read(true).write(true).create(true).truncate(false);
        let missing = || FsError::at("open the lock", path)(io::ErrorKind::NotFound.into());
        Self::open(path, &options)?.ok_or_else(missing)
    }

    /// Waits while another process of this machine holds it.
    fn exclusive(path: &Path) -> Result<Self> {
        let kernel = Self::create(path)?;
        let locked = if kernel.works { kernel.file.lock() } else { Ok(()) };
        kernel.settle(locked)
    }

    /// `None` while another process of this machine holds it.
    fn try_exclusive(path: &Path) -> Result<Option<Self>> {
        let kernel = Self::create(path)?;
        let locked = if kernel.works { kernel.file.try_lock() } else { Ok(()) };
        kernel.try_settle(locked)
    }

    /// Waits while another process of this machine holds it exclusively; `None` where there is no such file.
    fn shared(path: &Path) -> Result<Option<Self>> {
        let Some(kernel) = Self::open(path, OpenOptions::new().read(true))? else { return Ok(None) };
        let locked = if kernel.works { kernel.file.lock_shared() } else { Ok(()) };
        kernel.settle(locked).map(Some)
    }

    /// True while a process of this machine holds it; `None` where there are no kernel locks.
    fn is_held(path: &Path) -> Result<Option<bool>> {
        let Some(kernel) = Self::open(path, OpenOptions::new().read(true))? else { return Ok(Some(false)) };
        let locked = if kernel.works { kernel.file.try_lock_shared() } else { Ok(()) };
        Ok(match kernel.try_settle(locked)? {
            None => Some(true),
            Some(kernel) => kernel.works.then_some(false),
        })
    }

    fn try_settle(self, locked: std::result::Result<(), TryLockError>) -> Result<Option<Self>> {
        match locked {
            Ok(()) => Ok(Some(self)),
            Err(TryLockError::WouldBlock) => Ok(None),
            Err(TryLockError::Error(error)) => self.settle(Err(error)).map(Some),
        }
    }

    /// A file system without kernel locks is no error: then leases decide.
    fn settle(mut self, locked: io::Result<()>) -> Result<Self> {
        const ABSENT: [Errno; 3] = [Errno::NOLCK, Errno::NOSYS, Errno::OPNOTSUPP];
        match locked {
            Ok(()) => Ok(self),
            Err(error) if ABSENT.iter().any(|absent| error.raw_os_error() == Some(absent.raw_os_error())) => {
                self.works = false;
                Ok(self)
            }
            Err(error) => Err(FsError::at("lock", &self.path)(error)),
        }
    }

    /// True where its file is still the one at its path.
    fn is_at_its_path(&self) -> Result<bool> {
        let ours = self.file.metadata().map_err(FsError::at("access", &self.path))?;
        let there = super::if_there("access", &self.path, std::fs::metadata(&self.path))?;
        Ok(there.is_some_and(|there| (ours.dev(), ours.ino()) == (there.dev(), there.ino())))
    }
}

impl Drop for Kernel {
    fn drop(&mut self) {
        // Closing would do; a duplicate of the descriptor in a child that was just forked would keep it a moment longer.
        let _ = self.file.unlock();
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_lock_is_held_by_one_and_free_once_dropped() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("lock");
        let first = Lock::try_acquire(&path).unwrap().unwrap();
        assert!(Lock::try_acquire(&path).unwrap().is_none());
        assert!(Lock::is_held(&path).unwrap() && !Lock::is_held(&folder.path().join("none")).unwrap());
        drop(first);
        assert!(!Lock::is_held(&path).unwrap());
        assert!(Lock::try_acquire(&path).unwrap().is_some());
    }

    #[test]
    fn a_waiter_does_not_take_a_lock_whose_file_was_removed() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("lock");
        let first = Lock::try_acquire(&path).unwrap().unwrap();
        let waiter = std::thread::spawn({
            let path = path.clone();
            move || Lock::acquire(&path).unwrap()
        });
        // Whether the waiter opened the file before or after it was removed, it ends with the one at the path.
        std::thread::sleep(Duration::from_millis(20));
        first.remove().unwrap();
        let second = waiter.join().unwrap();
        assert!(second.kernel.is_at_its_path().unwrap());
        assert!(Lock::try_acquire(&path).unwrap().is_none());
    }
}
