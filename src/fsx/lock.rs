//! Locks between processes. They are kernel locks: they disappear with their owner, and have no content that could be corrupted.

use std::fs::{File, OpenOptions, TryLockError};
use std::os::unix::fs::MetadataExt;
use std::path::{Path, PathBuf};

use super::{FsError, Result};

/// A lock that this process holds until it is dropped.
#[derive(Debug)]
pub struct Lock {
    file: File,
    path: PathBuf,
}

impl Lock {
    /// Takes the lock on `path` (a lock file, which is created if needed); `None` while another process holds it.
    ///
    /// # Errors
    /// The file cannot be created, or the file system does not support locks.
    pub fn try_acquire(path: &Path) -> Result<Option<Self>> {
        loop {
            let file = open(path)?;
            match file.try_lock() {
                Err(TryLockError::WouldBlock) => return Ok(None),
                Err(TryLockError::Error(error)) => return Err(FsError::at("lock", path)(error)),
                Ok(()) if is_at(&file, path)? => return Ok(Some(Self { file, path: path.to_owned() })),
                Ok(()) => {}
            }
        }
    }

    /// Takes the lock on `path`; waits while another process holds it.
    ///
    /// # Errors
    /// As [`Lock::try_acquire`].
    pub fn acquire(path: &Path) -> Result<Self> {
        loop {
            let file = open(path)?;
            file.lock().map_err(FsError::at("lock", path))?;
            if is_at(&file, path)? {
                return Ok(Self { file, path: path.to_owned() });
            }
        }
    }

    /// Takes the lock on `path` in shared mode; waits while another process holds it exclusively. `None` where there is no such
    /// file.
    ///
    /// # Errors
    /// The file exists and cannot be opened, or the file system does not support locks.
    pub fn shared(path: &Path) -> Result<Option<Self>> {
        let Some(file) = super::if_there("open the lock", path, File::open(path))? else { return Ok(None) };
        file.lock_shared().map_err(FsError::at("lock", path))?;
        Ok(Some(Self { file, path: path.to_owned() }))
    }

    /// True while the lock on `path` is held. Creates no file.
    ///
    /// # Errors
    /// The file exists and cannot be opened, or the file system does not support locks.
    pub fn is_held(path: &Path) -> Result<bool> {
        let Some(file) = super::if_there("open the lock", path, File::open(path))? else { return Ok(false) };
        match file.try_lock_shared() {
            Ok(()) => Ok(false),
            Err(TryLockError::WouldBlock) => Ok(true),
            Err(TryLockError::Error(error)) => Err(FsError::at("lock", path)(error)),
        }
    }

    /// Releases the lock and removes its file, so that lock files do not pile up. A waiting process creates a new one.
    ///
    /// # Errors
    /// The file cannot be removed; the lock is released all the same.
    pub fn remove(self) -> Result<()> {
        // Removed while the lock is held: a process that opened the file before notices, once it has the lock, that it is no longer
        // the file at the path, and tries again.
        super::remove_file(&self.path).map(drop)
    }

    /// The lock file as an empty stdin for a new process: the lock is held until that process and all that inherit its stdin are
    /// gone, even if this one dies.
    ///
    /// # Errors
    /// There is no file descriptor left.
    pub fn as_input(&self) -> std::io::Result<File> {
        self.file.set_len(0)?;
        self.file.try_clone()
    }

    /// Its file.
    pub fn path(&self) -> &Path {
        &self.path
    }
}

impl Drop for Lock {
    fn drop(&mut self) {
        // Closing would do; a duplicate of the descriptor in a child that was just forked would keep it a moment longer.
        let _ = self.file.unlock();
    }
}

fn open(path: &Path) -> Result<File> {
    let opened = OpenOptions::new().read(true).write(true).create(true).truncate(false).open(path);
    opened.map_err(FsError::at("open the lock", path))
}

fn is_at(file: &File, path: &Path) -> Result<bool> {
    let ours = file.metadata().map_err(FsError::at("access", path))?;
    match std::fs::metadata(path) {
        Ok(there) => Ok((ours.dev(), ours.ino()) == (there.dev(), there.ino())),
        Err(error) if error.kind() == std::io::ErrorKind::NotFound => Ok(false),
        Err(error) => Err(FsError::at("access", path)(error)),
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
        std::thread::sleep(std::time::Duration::from_millis(20));
        first.remove().unwrap();
        let second = waiter.join().unwrap();
        assert!(is_at(&second.file, &path).unwrap());
        assert!(Lock::try_acquire(&path).unwrap().is_none());
    }
}
