//! Fast access to thousands of files in one folder through an open folder handle; and moving a file without replacing another.

use std::io;
use std::path::{Path, PathBuf};
use std::sync::{Arc, OnceLock};

use rustix::fs::{AtFlags, CWD, FileType, Mode, OFlags, RenameFlags};
use rustix::io::Errno;

use super::fault::step;
use super::{Entry, FsError, Result, entry};

/// A folder that is kept open once it exists. It may be created later.
#[derive(Clone, Debug)]
pub struct Dir {
    path: PathBuf,
    open: OnceLock<Arc<std::os::fd::OwnedFd>>,
}

impl Dir {
    /// The folder at `path`, which need not exist yet.
    pub fn new(path: PathBuf) -> Self {
        Self { path, open: OnceLock::new() }
    }

    /// The type of `name` in the folder, links not followed; `None` where there is none.
    pub fn entry(&self, name: &str) -> Result<Option<Entry>> {
        if let Some(folder) = self.folder() {
            match rustix::fs::statat(&**folder, name, AtFlags::SYMLINK_NOFOLLOW) {
                Ok(stat) => {
                    let kind = FileType::from_raw_mode(stat.st_mode);
                    return Ok(Some(match kind {
                        FileType::RegularFile => Entry::File(u64::try_from(stat.st_size).unwrap_or(0)),
                        FileType::Directory => Entry::Folder,
                        _ => Entry::Other,
                    }));
                }
                Err(Errno::NOENT) => {}
                Err(error) => return Err(FsError::at("access", &self.path.join(name))(error.into())),
            }
        }
        // The open folder may have been replaced by another one.
        entry(&self.path.join(name))
    }

    fn folder(&self) -> Option<&Arc<std::os::fd::OwnedFd>> {
        if self.open.get().is_none() {
            let flags = OFlags::PATH | OFlags::DIRECTORY | OFlags::CLOEXEC;
            let folder = rustix::fs::openat(CWD, &self.path, flags, Mode::empty()).ok()?;
            let _ = self.open.set(Arc::new(folder));
        }
        self.open.get()
    }

    /// Where it is.
    pub fn path(&self) -> &Path {
        &self.path
    }
}

/// Moves `from` to `to` without replacing a file, and creates the folder of `to` if it is missing: true where it was. `None` where
/// `to` exists; then nothing is moved.
pub fn rename_new(from: &Path, to: &Path) -> Result<Option<bool>> {
    step("rename", to)?;
    let once = || match rustix::fs::renameat_with(CWD, from, CWD, to, RenameFlags::NOREPLACE) {
        // Not every file system knows this; a second name is as good, and then the first is one too many.
        Err(Errno::INVAL | Errno::NOSYS) => {
            std::fs::hard_link(from, to)?;
            std::fs::remove_file(from)
        }
        result => result.map_err(Into::into),
    };
    let is = |error: &io::Error, kind| error.kind() == kind;
    let (result, made) = match (once(), to.parent()) {
        (Err(error), Some(folder)) if is(&error, io::ErrorKind::NotFound) => {
            super::create_dir_all(folder)?;
            (once(), true)
        }
        (result, _) => (result, false),
    };
    match result {
        Ok(()) => Ok(Some(made)),
        Err(error) if is(&error, io::ErrorKind::AlreadyExists) => Ok(None),
        Err(error) => Err(FsError::at("move a file to", to)(error)),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::fsx;

    #[test]
    fn a_folder_is_looked_into_from_when_it_is_there_and_under_its_name() {
        let place = tempfile::tempdir().unwrap();
        let dir = Dir::new(place.path().join("d"));
        assert_eq!(dir.entry("a").unwrap(), None);
        fsx::create_dir(dir.path()).unwrap();
        fsx::write(&dir.path().join("a"), b"abc").unwrap();
        fsx::symlink(Path::new("a"), &dir.path().join("link")).unwrap();
        fsx::create_dir(&dir.path().join("sub")).unwrap();
        assert_eq!(dir.entry("a").unwrap(), Some(Entry::File(3)));
        assert_eq!(dir.entry("link").unwrap(), Some(Entry::Other));
        assert_eq!(dir.entry("sub").unwrap(), Some(Entry::Folder));
        assert_eq!(dir.entry("sub/b").unwrap(), None);
        // Removed and created again, as when a user clears the store during a run.
        fsx::remove_dir_all(dir.path()).unwrap();
        assert_eq!(dir.entry("a").unwrap(), None);
        fsx::create_dir(dir.path()).unwrap();
        fsx::write(&dir.path().join("a"), b"other").unwrap();
        assert_eq!(dir.entry("a").unwrap(), Some(Entry::File(5)));
    }

    #[test]
    fn a_file_is_moved_only_where_nothing_is_and_its_folder_is_made() {
        let place = tempfile::tempdir().unwrap();
        let (from, to) = (place.path().join("from"), place.path().join("new/to"));
        for (text, expected) in [(b"one", Some(true)), (b"two", None)] {
            fsx::write(&from, text).unwrap();
            assert_eq!(rename_new(&from, &to).unwrap(), expected);
        }
        assert_eq!((fsx::read(&to).unwrap(), fsx::read(&from).unwrap()), (b"one".to_vec(), b"two".to_vec()));
        assert_eq!(rename_new(&from, &place.path().join("new/other")).unwrap(), Some(false));
        assert!(rename_new(&from, &to).is_err(), "it is gone");
    }
}
