//! Contents: hashed, made read-only, and moved to the place that their name says.

use std::fs::File;
use std::io::{Read, Write};
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicU64, Ordering};

use rayon::prelude::*;

use super::{Digest, Run, Store, StoreError};
use crate::fsx::{self, Entry, FsError};

/// Copies from outside that this process has begun.
pub(super) static COPIES: AtomicU64 = AtomicU64::new(0);

/// The name and length of a file's content.
///
/// # Errors
/// It cannot be read, or is no regular file.
pub fn hash_file(path: &Path) -> fsx::Result<(Digest, u64)> {
    let file = fsx::open(path)?;
    hash(&file, path)
}

fn hash(file: &File, path: &Path) -> fsx::Result<(Digest, u64)> {
    let mut hasher = blake3::Hasher::new();
    hasher.update_reader(file).map_err(FsError::at("read", path))?;
    Ok((Digest::new(*hasher.finalize().as_bytes()), hasher.count()))
}

/// A content that is in its place and can be read by others, but does not outlive a power failure before
/// [`Blob::sync`].
#[derive(Debug)]
pub struct Blob {
    /// The name of the content.
    pub digest: Digest,
    /// Its length.
    pub bytes: u64,
    file: File,
    path: PathBuf,
    made_folder: bool,
    /// Contents that this one lists, which become durable before it.
    parts: Vec<(Digest, PathBuf)>,
}

impl Store {
    /// Takes `path`, a file in a private folder of this store, as a blob. The file may be gone afterwards.
    ///
    /// # Errors
    /// It cannot be read, or the store cannot be written.
    pub fn take(&self, path: &Path) -> Result<Blob, StoreError> {
        let mut file = fsx::open(path)?;
        if fsx::is_in_other_hands(&file, path)? {
            // Whoever has it can write into it whatever its name is then: a new file takes its place.
            fsx::copy_atomic(path, path)?;
            file = fsx::open(path)?;
        }
        let (digest, bytes) = hash(&file, path)?;
        self.adopt(file, path, digest, bytes)
    }

    /// As [`Store::take`], of a file whose content is known.
    fn adopt(&self, mut file: File, path: &Path, digest: Digest, bytes: u64) -> Result<Blob, StoreError> {
        let target = self.blob_path(&digest);
        let mut made_folder = false;
        match same_content(&target, digest, bytes)? {
            Some(there) => file = there,
            None => {
                fsx::make_read_only(&file, path)?;
                // Somebody else may be faster. What they put there stays: a stage may read it already, and takes another
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
                    // What is there is broken. It is replaced only by something that will not break in turn.
                    fsx::sync(&file, path)?;
                    made_folder = fsx::rename_into(path, &target)?;
                }
            }
        }
        Ok(Blob { digest, bytes, file, path: target, made_folder, parts: Vec::new() })
    }

    /// Copies a file from outside into the store, where nobody changes it while stages read it.
    ///
    /// # Errors
    /// Its content is not `digest` any more, it cannot be read, or the store cannot be written.
    pub fn import(&self, path: &Path, digest: &Digest, run: &Run) -> Result<(), StoreError> {
        let target = self.blob_path(digest);
        if let Some(Entry::File(bytes)) = fsx::entry(&target)?
            && same_content(&target, *digest, bytes)?.is_some()
        {
            return Ok(());
        }
        // Several stages may bring in the same file at once, each its own copy.
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

/// A file whose content is hashed as it is read.
pub(super) struct Hashing {
    file: File,
    hasher: blake3::Hasher,
}

impl Hashing {
    pub fn new(file: File) -> Self {
        Self { file, hasher: blake3::Hasher::new() }
    }

    /// The name of what was read so far.
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
    /// As the list of these contents.
    pub(super) fn with_parts(self, parts: Vec<(Digest, PathBuf)>) -> Self {
        Self { parts, ..self }
    }

    /// The name of the content, and of those that it lists.
    pub fn contents(&self) -> impl Iterator<Item = Digest> {
        std::iter::once(self.digest).chain(self.parts.iter().map(|(digest, _)| *digest))
    }

    /// Makes the contents that this one lists durable, and their names. Side by side: a disk does many at once.
    fn sync_parts(&self) -> fsx::Result<()> {
        self.parts.par_iter().try_for_each(|(_, part)| fsx::sync(&fsx::open(part)?, part))?;
        let mut folders: Vec<&Path> = self.parts.iter().filter_map(|(_, part)| part.parent()).collect();
        folders.sort_unstable();
        folders.dedup();
        folders.par_iter().try_for_each(|folder| fsx::sync_dir(folder))?;
        folders.first().and_then(|folder| folder.parent()).map_or(Ok(()), fsx::sync_dir)
    }

    /// Makes the content and its name durable.
    ///
    /// # Errors
    /// The disk refuses.
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

/// The file at `path`, if it has that content: one that only has the right length may be what a power failure left.
fn same_content(path: &Path, digest: Digest, bytes: u64) -> fsx::Result<Option<File>> {
    if fsx::entry(path)? != Some(Entry::File(bytes)) {
        return Ok(None);
    }
    let file = fsx::open(path)?;
    Ok((hash(&file, path)?.0 == digest).then_some(file))
}
