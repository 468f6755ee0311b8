//! Looking at thousands of files in one folder, without walking the whole path to it for each of them.

use std::path::{Path, PathBuf};
use std::sync::{Arc, OnceLock};

use rustix::fs::{AtFlags, CWD, FileType, Mode, OFlags};
use rustix::io::Errno;

use super::{Entry, FsError, Result, entry};

/// A folder that is kept open once it was found. It may come into being later.
#[derive(Clone, Debug)]
pub struct Dir {
    path: PathBuf,
    open: OnceLock<Arc<std::os::fd::OwnedFd>>,
}

impl Dir {
    /// The folder at `path`, which need not be there yet.
    pub fn new(path: PathBuf) -> Self {
        Self { path, open: OnceLock::new() }
    }

    /// What is at `name` in the folder, links not followed; `None` where nothing is.
    ///
    /// # Errors
    /// It cannot be looked at.
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
                Err(error) => return Err(FsError::at("look at", &self.path.join(name))(error.into())),
            }
        }
        // Somebody may have put another folder in the place of the one that is open.
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
        // Taken away and made anew, as by someone who clears the store under our hands.
        fsx::remove_dir_all(dir.path()).unwrap();
        assert_eq!(dir.entry("a").unwrap(), None);
        fsx::create_dir(dir.path()).unwrap();
        fsx::write(&dir.path().join("a"), b"other").unwrap();
        assert_eq!(dir.entry("a").unwrap(), Some(Entry::File(5)));
    }
}
