//! Private copies of blobs, for external programs: whatever a program does to a copy does not reach the store, whichever user runs it
//! and whatever permissions the program sets.
//!
//! Where the file system can share blocks between files (btrfs, XFS, bcachefs, ZFS since 2.2), a copy is free. Elsewhere its bytes
//! are read, hashed and written, so that a damaged blob is found before a program reads it.

use std::path::{Path, PathBuf};

use rayon::prelude::*;

use super::folder::{FolderEntry, Part};
use super::{Digest, Store, StoreError};
use crate::fsx::{self, FsError, Made};

/// Folders with at least this many files are copied by several threads.
const SIDE_BY_SIDE: usize = 64;

/// A copy, with its metadata at the time of copying.
#[derive(Debug)]
pub struct PrivateCopy {
    path: PathBuf,
    digest: Digest,
    made: Made,
}

impl PrivateCopy {
    /// Keeps it open, so that a file that replaces it is not mistaken for it (a removed file's inode number is reused).
    ///
    /// # Errors
    /// It no longer exists.
    pub fn hold(&mut self) -> fsx::Result<()> {
        self.made.hold(&self.path)
    }

    /// Its path.
    pub fn path(&self) -> &Path {
        &self.path
    }

    /// Accepts that it has got another name (a hard link), which changes its change time. Without this, its content would be read
    /// again to see whether it has changed. No program may have been able to write to it yet.
    ///
    /// # Errors
    /// It cannot be accessed.
    pub fn was_linked(&mut self) -> fsx::Result<()> {
        let known = self.made.stat;
        let now = self.made.now(&self.path)?;
        if let Some(now) = now.filter(|now| (now.bytes, now.modified) == (known.bytes, known.modified)) {
            self.made.stat = now;
        }
        Ok(())
    }

    /// True where the content of the copy has changed. A copy that was removed or replaced by another file was not changed.
    ///
    /// # Errors
    /// It exists and cannot be read.
    pub fn was_changed(&self) -> fsx::Result<bool> {
        let Some(now) = self.made.now(&self.path)?.filter(|now| *now != self.made.stat) else {
            return Ok(false);
        };
        // Perhaps only its permissions or times changed.
        Ok(now.bytes != self.made.stat.bytes || super::hash_file(&self.path)?.0 != self.digest)
    }
}

impl Store {
    /// Copies a blob to the new file `to`, read-only, and executable where requested.
    ///
    /// # Errors
    /// It is missing or damaged, or `to` cannot be written. A damaged blob is moved to quarantine, so that it is rebuilt.
    pub fn copy_out(&self, digest: &Digest, to: &Path, executable: bool) -> Result<PrivateCopy, StoreError> {
        let from = self.blob_path(digest);
        let source = match fsx::open(&from) {
            Err(error) if error.is_not_found() => return Err(StoreError::Missing(from)),
            source => source?,
        };
        let mode = if executable { 0o555 } else { 0o444 };
        let made = match fsx::clone_file(&source, to, mode)? {
            Some(made) => made,
            None => {
                let mut hashing = super::blob::Hashing::new(source);
                let made = fsx::copy_with_mode(&mut hashing, &from, to, mode)?;
                if hashing.digest() != *digest {
                    fsx::remove_file(to)?;
                    return Err(self.put_aside(from)?);
                }
                made
            }
        };
        Ok(PrivateCopy { path: to.to_owned(), digest: *digest, made })
    }

    /// Creates the folder with this digest at `to`, from private copies.
    ///
    /// # Errors
    /// As [`Store::copy_out`].
    pub fn copy_out_folder(&self, digest: &Digest, to: &Path) -> Result<Vec<PrivateCopy>, StoreError> {
        let folder = self.folder_to_read(digest)?;
        fsx::create_dir_all(to)?;
        let mut made = Path::new("");
        for FolderEntry { path, what } in folder.entries() {
            let above = if *what == Part::Empty { path } else { path.parent().unwrap_or(Path::new("")) };
            // Sorted by path, so that files of one folder are mostly together.
            if above != made {
                fsx::create_dir_all(&to.join(above))?;
                made = above;
            }
            if let Part::Link(target) = what {
                fsx::symlink(target, &to.join(path))?;
            }
        }
        let files: Vec<_> = folder.files().collect();
        let one = |(path, file): &(&Path, super::FolderFile)| {
            self.copy_out(&file.digest, &to.join(path), file.executable)
        };
        if files.len() < SIDE_BY_SIDE {
            files.iter().map(one).collect()
        } else {
            files.par_iter().map(one).collect()
        }
    }

    /// Moves a damaged blob to quarantine, so that it is rebuilt when needed.
    fn put_aside(&self, path: PathBuf) -> Result<StoreError, FsError> {
        self.quarantine(&path)?;
        Ok(StoreError::Damaged(path))
    }
}

#[cfg(test)]
mod tests {
    use std::io::Write;

    use super::*;

    fn store_with(content: &[u8]) -> (tempfile::TempDir, Store, Digest) {
        let place = tempfile::tempdir().unwrap();
        let store = Store::open(&place.path().join("store")).unwrap();
        let draft = place.path().join("draft");
        fsx::write(&draft, content).unwrap();
        let digest = store.take(&draft).unwrap().digest;
        (place, store, digest)
    }

    fn overwrite(path: &Path, bytes: &[u8]) {
        let mut rights = std::fs::metadata(path).unwrap().permissions();
        std::os::unix::fs::PermissionsExt::set_mode(&mut rights, 0o644);
        std::fs::set_permissions(path, rights).unwrap();
        std::fs::OpenOptions::new().write(true).open(path).unwrap().write_all(bytes).unwrap();
    }

    #[test]
    fn a_changed_copy_is_noticed_and_does_not_reach_the_store() {
        let (place, store, digest) = store_with(b"content");
        let copy = store.copy_out(&digest, &place.path().join("copy"), false).unwrap();
        assert!(!copy.was_changed().unwrap());
        let modified = std::fs::metadata(copy.path()).unwrap().modified().unwrap();
        std::thread::sleep(std::time::Duration::from_millis(15));
        // As many bytes as before, and the time put back.
        overwrite(copy.path(), b"CONTENT");
        std::fs::File::options().write(true).open(copy.path()).unwrap().set_modified(modified).unwrap();
        assert!(copy.was_changed().unwrap());
        assert_eq!(fsx::read(&store.blob_path(&digest)).unwrap(), b"content");
    }

    #[test]
    fn a_copy_with_another_name_counts_as_unchanged_without_being_read() {
        let (place, store, digest) = store_with(b"content");
        let mut copy = store.copy_out(&digest, &place.path().join("copy"), false).unwrap();
        let before = copy.made.stat;
        std::thread::sleep(std::time::Duration::from_millis(15));
        fsx::link_tree(copy.path(), &place.path().join("name")).unwrap();
        copy.was_linked().unwrap();
        assert_ne!(copy.made.stat, before);
        assert_eq!(copy.made.now(copy.path()).unwrap(), Some(copy.made.stat));
        overwrite(&place.path().join("name"), b"another");
        assert!(copy.was_changed().unwrap());
        // What was written before the names were accepted is no name.
        let mut copy = store.copy_out(&digest, &place.path().join("other"), false).unwrap();
        overwrite(copy.path(), b"CONTENT and more");
        copy.was_linked().unwrap();
        assert!(copy.was_changed().unwrap());
    }

    #[test]
    fn other_permissions_or_a_replaced_file_are_not_a_changed_copy() {
        let (place, store, digest) = store_with(b"content");
        let mut copy = store.copy_out(&digest, &place.path().join("copy"), true).unwrap();
        copy.hold().unwrap();
        std::thread::sleep(std::time::Duration::from_millis(15));
        overwrite(copy.path(), b"");
        assert!(!copy.was_changed().unwrap());
        std::fs::remove_file(copy.path()).unwrap();
        assert!(!copy.was_changed().unwrap());
        fsx::write(copy.path(), b"another").unwrap();
        assert!(!copy.was_changed().unwrap());
    }

    #[test]
    fn a_damaged_blob_is_never_copied_out_and_is_moved_to_quarantine() {
        let (place, store, digest) = store_with(b"content");
        overwrite(&store.blob_path(&digest), b"CONTENT");
        let to = place.path().join("copy");
        assert!(matches!(store.copy_out(&digest, &to, false), Err(StoreError::Damaged(_))));
        assert!(!to.exists() && !store.blob_path(&digest).exists());
        assert_eq!(fsx::list(&store.root().join("quarantine-v1")).unwrap().len(), 1);
        assert!(matches!(store.copy_out(&digest, &to, false), Err(StoreError::Missing(_))));
    }
}
