//! Blobs: files that are hashed, made read-only, and moved to the path of their digest.

use std::fs::File;
use std::io::{Read, Write};
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicU64, Ordering};

use rayon::prelude::*;

use super::{Digest, Run, Store, StoreError};
use crate::fsx::{self, Entry, FsError};

/// Number of imports that this process has started.
pub(super) static COPIES: AtomicU64 = AtomicU64::new(0);

/// The digest and length of a file.
///
/// # Errors
/// It cannot be read, or is not a regular file.
pub fn hash_file(path: &Path) -> fsx::Result<(Digest, u64)> {
    let file = fsx::open(path)?;
    hash(&file, path)
}

fn hash(file: &File, path: &Path) -> fsx::Result<(Digest, u64)> {
    let mut hasher = blake3::Hasher::new();
    hasher.update_reader(file).map_err(FsError::at("read", path))?;
    Ok((Digest::new(*hasher.finalize().as_bytes()), hasher.count()))
}

/// A blob that others can read, but that may not survive a power failure before [`Blob::sync`].
#[derive(Debug)]
pub struct Blob {
    /// Its digest.
    pub digest: Digest,
    /// Its length.
    pub bytes: u64,
    file: File,
    path: PathBuf,
    made_folder: bool,
    /// The blobs that a folder list names; they become durable before it.
    parts: Vec<(Digest, PathBuf)>,
}

impl Store {
    /// Takes `path`, a file in a private folder of this store, as a blob. The file may be moved. The caller has protected the
    /// digest from `gc` (see [`Run::rely_on`]).
    ///
    /// # Errors
    /// It cannot be read, or the store cannot be written.
    pub fn take(&self, path: &Path) -> Result<Blob, StoreError> {
        let draft = draft(path)?;
        self.adopt(draft.file, path, draft.digest, draft.bytes)
    }

    /// As [`Store::take`]; protects the blob from `gc` until the end of the run, before it is in the store.
    ///
    /// # Errors
    /// As [`Store::take`].
    pub fn take_for(&self, path: &Path, run: &Run) -> Result<Blob, StoreError> {
        let draft = draft(path)?;
        run.rely_on([], [draft.digest])?;
        let _held = self.hold()?;
        self.adopt(draft.file, path, draft.digest, draft.bytes)
    }

    /// As [`Store::take`], for a file whose digest is known.
    pub(super) fn adopt(
        &self,
        mut file: File,
        path: &Path,
        digest: Digest,
        bytes: u64,
    ) -> Result<Blob, StoreError> {
        let target = self.blob_path(&digest);
        let mut made_folder = false;
        match same_content(&target, digest, bytes)? {
            Some(there) => file = there,
            None => {
                fsx::make_read_only(&file, path)?;
                // Another process may be faster. Its file stays: a stage may read it already, and would mistake another
                // file in its place for one that was changed.
                let made = match fsx::entry(&target)? {
                    None => fsx::rename_new(path, &target)?,
                    Some(_) => None,
                };
                if let Some(made) = made {
                    made_folder = made;
                } else if let Some(there) = same_content(&target, digest, bytes)? {
                    file = there;
                } else {
                    // The existing file is damaged. Its replacement is made durable first.
                    fsx::sync(&file, path)?;
                    made_folder = fsx::rename_into(path, &target)?;
                }
            }
        }
        Ok(Blob { digest, bytes, file, path: target, made_folder, parts: Vec::new() })
    }

    /// Copies a file from outside into the store, so that nobody changes it while stages read it.
    ///
    /// # Errors
    /// Its content is no longer `digest`, it cannot be read, or the store cannot be written.
    pub fn import(&self, path: &Path, digest: &Digest, run: &Run) -> Result<(), StoreError> {
        let target = self.blob_path(digest);
        if let Some(Entry::File(bytes)) = fsx::entry(&target)?
            && same_content(&target, *digest, bytes)?.is_some()
        {
            return Ok(());
        }
        // Several stages may import the same file at once, each with its own copy.
        let number = COPIES.fetch_add(1, Ordering::Relaxed);
        let copy = run.temporary().join(format!("import-{number}-{digest}"));
        let mut hashing = Hashing::new(fsx::open(path)?);
        fsx::copy_from(&mut hashing, path, &copy)?;
        if hashing.digest() != *digest {
            fsx::remove_file(&copy)?;
            return Err(StoreError::Changed(path.to_owned()));
        }
        let bytes = hashing.hasher.count();
        Ok(self.adopt(fsx::open(&copy)?, &copy, *digest, bytes)?.sync()?)
    }
}

/// A file that is to become a blob.
pub(super) struct Draft {
    file: File,
    /// Its digest.
    pub digest: Digest,
    /// Its length.
    pub bytes: u64,
}

/// Hashes `path`, a file in a private folder of a store, that nobody can change from now on.
pub(super) fn draft(path: &Path) -> fsx::Result<Draft> {
    let mut file = fsx::open(path)?;
    if fsx::is_in_other_hands(&file, path)? {
        // A process that has it open or linked could still write to it, so it is copied to a new file.
        fsx::copy_atomic(path, path)?;
        file = fsx::open(path)?;
    }
    let (digest, bytes) = hash(&file, path)?;
    Ok(Draft { file, digest, bytes })
}

/// A file whose content is hashed as it is read.
pub(super) struct Hashing {
    file: File,
    hasher: blake3::Hasher,
}

impl Hashing {
    pub fn new(file: File) -> Self {
        Self { file, hasher: blake3::Hasher::new() }
    }

    /// The digest of what was read so far.
    pub fn digest(&self) -> Digest {
        Digest::new(*self.hasher.finalize().as_bytes())
    }
}

impl Read for Hashing {
    fn read(&mut self, buffer: &mut [u8]) -> std::io::Result<usize> {
        let count = self.file.read(buffer)?;
        self.hasher.write_all(&buffer[..count])?;
        Ok(count)
    }
}

impl Blob {
    /// As the list of these blobs.
    pub(super) fn with_parts(self, parts: Vec<(Digest, PathBuf)>) -> Self {
        Self { parts, ..self }
    }

    /// Its digest, and the digests that it lists.
    pub fn contents(&self) -> impl Iterator<Item = Digest> {
        std::iter::once(self.digest).chain(self.parts.iter().map(|(digest, _)| *digest))
    }

    /// Makes the listed blobs and their names durable, in parallel.
    fn sync_parts(&self) -> fsx::Result<()> {
        self.parts.par_iter().try_for_each(|(_, part)| fsx::sync(&fsx::open(part)?, part))?;
        let mut folders: Vec<&Path> = self.parts.iter().filter_map(|(_, part)| part.parent()).collect();
        folders.sort_unstable();
        folders.dedup();
        folders.par_iter().try_for_each(|folder| fsx::sync_dir(folder))?;
        folders.first().and_then(|folder| folder.parent()).map_or(Ok(()), fsx::sync_dir)
    }

    /// Makes the blob and its name durable.
    ///
    /// # Errors
    /// It cannot be synced.
    pub fn sync(&self) -> fsx::Result<()> {
        if !self.parts.is_empty() {
            self.sync_parts()?;
        }
        fsx::sync(&self.file, &self.path)?;
        if let Some(folder) = self.path.parent() {
            fsx::sync_dir(folder)?;
            if let Some(above) = folder.parent().filter(|_| self.made_folder) {
                fsx::sync_dir(above)?;
            }
        }
        Ok(())
    }
}

/// The file at `path`, if it has that digest: a file with only the right length may be left from a power failure.
fn same_content(path: &Path, digest: Digest, bytes: u64) -> fsx::Result<Option<File>> {
    if fsx::entry(path)? != Some(Entry::File(bytes)) {
        return Ok(None);
    }
    let file = fsx::open(path)?;
    Ok((hash(&file, path)?.0 == digest).then_some(file))
}
