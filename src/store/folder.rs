//! Folders as artifacts. Every file of a folder is a blob; the folder is a blob that lists them, and the digest of that list is
//! the digest of the folder. So folders that share files share blobs, and a stage gets links instead of copies.
//!
//! ```text
//! dril-folder 1
//! <64 digits> <bytes> - data/a.csv        a file
//! <64 digits> <bytes> x bin/tool          an executable file
//! - 0 d logs                              an empty folder
//! data/b.csv 0 l last.csv                 a link, and its target relative to it
//! ```
//!
//! Lines are sorted by path. `%`, spaces and bytes outside printable ASCII are written as `%` and two hexadecimal digits. Owners,
//! times and all other permissions are omitted: they are not content.

use std::collections::HashSet;
use std::ffi::OsString;
use std::os::unix::ffi::{OsStrExt, OsStringExt};
use std::path::{Path, PathBuf};
use std::sync::atomic::Ordering;

use rayon::prelude::*;

use super::{Blob, Digest, Run, Store, StoreError, Stored};
use crate::fsx::{self, Links, What};

const HEAD: &str = "dril-folder 1";

/// The contents of a folder, sorted by path.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Folder {
    entries: Vec<FolderEntry>,
}

/// An entry of a folder.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct FolderEntry {
    /// Its path relative to the folder, without `.` and `..`.
    pub path: PathBuf,
    /// What it is.
    pub what: Part,
}

/// The types of entries in a folder.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Part {
    /// A file.
    File(FolderFile),
    /// An empty folder.
    Empty,
    /// A link to something in the same folder, as [`fsx::What::Link`].
    Link(PathBuf),
}

/// A file in a folder.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct FolderFile {
    /// Its digest.
    pub digest: Digest,
    /// Its length.
    pub bytes: u64,
    /// True where it is executable.
    pub executable: bool,
}

impl Folder {
    /// A folder with these entries, in any order.
    pub fn new(mut entries: Vec<FolderEntry>) -> Self {
        entries.sort_by(|a, b| a.path.as_os_str().as_bytes().cmp(b.path.as_os_str().as_bytes()));
        Self { entries }
    }

    /// Its entries.
    pub fn entries(&self) -> &[FolderEntry] {
        &self.entries
    }

    /// Its files.
    pub fn files(&self) -> impl Iterator<Item = (&Path, FolderFile)> {
        self.entries.iter().filter_map(|entry| match entry.what {
            Part::File(file) => Some((entry.path.as_path(), file)),
            Part::Empty | Part::Link(_) => None,
        })
    }

    /// The list as it is stored.
    pub fn to_bytes(&self) -> Vec<u8> {
        let mut text = format!("{HEAD}\n");
        for FolderEntry { path, what } in &self.entries {
            let path = escape(path);
            match what {
                Part::File(FolderFile { digest, bytes, executable }) => {
                    let mark = if *executable { 'x' } else { '-' };
                    text += &format!("{digest} {bytes} {mark} {path}\n");
                }
                Part::Empty => text += &format!("- 0 d {path}\n"),
                Part::Link(to) => text += &format!("{} 0 l {path}\n", escape(to)),
            }
        }
        text.into_bytes()
    }

    /// The folder's digest: that of its list.
    pub fn digest(&self) -> Digest {
        Digest::of(&self.to_bytes())
    }

    /// Parses a list. It is accepted only in exactly the form that we write, so that no path in it leads out of the folder.
    ///
    /// # Errors
    /// What is wrong with it.
    pub fn parse(bytes: &[u8]) -> Result<Self, String> {
        let text = std::str::from_utf8(bytes).map_err(|error| error.to_string())?;
        let mut lines = text.lines();
        match lines.next() {
            Some(HEAD) => {}
            head => return Err(format!("it starts with `{}`, expected `{HEAD}`", head.unwrap_or_default())),
        }
        let entries: Option<Vec<FolderEntry>> = lines.map(entry).collect();
        let folder = Self { entries: entries.ok_or("it has an invalid line")? };
        let name = |part: &[u8]| !matches!(part, b"" | b"." | b"..");
        let names_only =
            |entry: &FolderEntry| entry.path.as_os_str().as_bytes().split(|byte| *byte == b'/').all(name);
        let paths: HashSet<&Path> = folder.entries.iter().map(|entry| entry.path.as_path()).collect();
        let apart = |entry: &FolderEntry| !entry.path.ancestors().skip(1).any(|above| paths.contains(above));
        let leads_inside = |entry: &FolderEntry| match &entry.what {
            Part::Link(to) => fsx::is_plain_target(entry.path.parent().unwrap_or(Path::new("")), to),
            Part::File(_) | Part::Empty => true,
        };
        if folder.entries.iter().all(names_only)
            && folder.entries.iter().all(leads_inside)
            && folder.entries.iter().all(apart)
            && paths.len() == folder.entries.len()
            && Self::new(folder.entries.clone()).to_bytes() == bytes
        {
            Ok(folder)
        } else {
            Err("its paths are not sorted, lead out of the folder, or overlap".to_owned())
        }
    }
}

/// Hashes a folder.
///
/// # Errors
/// Something in it cannot be read, or is neither a file nor a folder.
pub fn hash_folder(path: &Path) -> fsx::Result<Folder> {
    let entries = fsx::walk(path, Links::Keep, &fsx::nothing)?.into_par_iter().map(|inside| {
        let what = match inside.what {
            What::File(stat) => {
                let (digest, bytes) = super::hash_file(&path.join(&inside.path))?;
                Part::File(FolderFile { digest, bytes, executable: stat.executable })
            }
            What::Empty => Part::Empty,
            What::Link(to) => Part::Link(to),
        };
        Ok(FolderEntry { path: inside.path, what })
    });
    Ok(Folder::new(entries.collect::<fsx::Result<_>>()?))
}

fn escape(path: &Path) -> String {
    let mut text = String::new();
    for &byte in path.as_os_str().as_bytes() {
        if byte.is_ascii_graphic() && byte != b'%' {
            text.push(char::from(byte));
        } else {
            text += &format!("%{byte:02x}");
        }
    }
    text
}

fn unescape(text: &str) -> Option<PathBuf> {
    let mut bytes = Vec::with_capacity(text.len());
    let mut rest = text.as_bytes();
    while let Some((&byte, after)) = rest.split_first() {
        if byte == b'%' {
            let digits = std::str::from_utf8(after.get(..2)?).ok()?;
            bytes.push(u8::from_str_radix(digits, 16).ok().filter(|byte| *byte != 0)?);
            rest = &after[2..];
        } else {
            bytes.push(byte);
            rest = after;
        }
    }
    Some(PathBuf::from(OsString::from_vec(bytes)))
}

fn entry(line: &str) -> Option<FolderEntry> {
    let mut words = line.splitn(4, ' ');
    let (digest, bytes, mark, path) = (words.next()?, words.next()?, words.next()?, words.next()?);
    let what = match (digest, mark) {
        ("-", "d") => Part::Empty,
        (to, "l") => Part::Link(unescape(to)?),
        (digest, "-" | "x") => Part::File(FolderFile {
            digest: digest.parse().ok()?,
            bytes: bytes.parse().ok()?,
            executable: mark == "x",
        }),
        _ => return None,
    };
    Some(FolderEntry { path: unescape(path)?, what })
}

impl Store {
    /// Takes `path`, a folder in a private folder of this store, as blobs. Its files may be moved. Protects the blobs from `gc`
    /// until the end of the run, before they are in the store.
    ///
    /// # Errors
    /// It contains something that is neither a file nor a folder, it cannot be read, or the store cannot be written.
    pub fn take_folder_for(&self, path: &Path, run: &Run) -> Result<Blob, StoreError> {
        self.take_folder_after(path, |digests| run.rely_on([], digests))
    }

    /// As [`Store::take_folder_for`], without protection.
    #[cfg(test)]
    pub(crate) fn take_folder(&self, path: &Path) -> Result<Blob, StoreError> {
        self.take_folder_after(path, |_| Ok(()))
    }

    /// Takes a folder after `protect` was called with the digests of the blobs.
    fn take_folder_after(
        &self,
        path: &Path,
        protect: impl FnOnce(Vec<Digest>) -> Result<(), StoreError>,
    ) -> Result<Blob, StoreError> {
        let found = fsx::walk(path, Links::Keep, &fsx::nothing)?;
        let drafts = found.into_par_iter().map(|inside| {
            let what = match inside.what {
                What::File(stat) => {
                    let at = path.join(&inside.path);
                    fsx::be_a_file(&at)?;
                    let draft = super::blob::draft(&at)?;
                    let (digest, bytes) = (draft.digest, draft.bytes);
                    Part::File(FolderFile { digest, bytes, executable: stat.executable })
                }
                What::Empty => Part::Empty,
                What::Link(to) => Part::Link(to),
            };
            Ok::<_, StoreError>(FolderEntry { path: inside.path, what })
        });
        let folder = Folder::new(drafts.collect::<Result<_, _>>()?);
        let files: Vec<(&Path, FolderFile)> = folder.files().collect();
        protect(files.iter().map(|(_, file)| file.digest).chain([folder.digest()]).collect())?;
        let _held = self.hold()?;
        files.par_iter().try_for_each(|(inside, file)| {
            let at = path.join(inside);
            self.adopt(fsx::open(&at)?, &at, file.digest, file.bytes).map(drop)
        })?;
        self.take_list(&folder, &path.with_extension("list"))
    }

    /// Copies a folder from outside, whose content was `folder` at the time of planning, into the store.
    ///
    /// # Errors
    /// It has changed, cannot be read, or the store cannot be written.
    pub fn import_folder(&self, path: &Path, folder: &Folder, run: &Run) -> Result<(), StoreError> {
        let files: Vec<(&Path, FolderFile)> = folder.files().collect();
        files.par_iter().try_for_each(|(inside, file)| self.import(&path.join(inside), &file.digest, run))?;
        let number = super::blob::COPIES.fetch_add(1, Ordering::Relaxed);
        let draft = run.temporary().join(format!("list-{number}"));
        Ok(self.take_list(folder, &draft)?.sync()?)
    }

    fn take_list(&self, folder: &Folder, draft: &Path) -> Result<Blob, StoreError> {
        fsx::write(draft, &folder.to_bytes())?;
        let parts = folder.files().map(|(_, file)| (file.digest, self.blob_path(&file.digest))).collect();
        Ok(self.take(draft)?.with_parts(parts))
    }

    /// The list of a folder; `None` where it is missing or damaged.
    ///
    /// # Errors
    /// It exists and cannot be read.
    pub fn folder(&self, digest: &Digest) -> Result<Option<Folder>, StoreError> {
        let bytes = fsx::read_if_there(&self.blob_path(digest))?;
        let bytes = bytes.filter(|bytes| Digest::of(bytes) == *digest);
        Ok(bytes.and_then(|bytes| Folder::parse(&bytes).ok()))
    }

    /// All blobs of an output, with their lengths: its own and, for a folder, those of its files.
    ///
    /// # Errors
    /// The list of a folder exists and cannot be read.
    pub fn contents(&self, stored: &Stored) -> Result<Vec<(Digest, u64)>, StoreError> {
        let mut all = vec![(stored.digest, stored.bytes)];
        if stored.folder
            && let Some(folder) = self.folder(&stored.digest)?
        {
            all.extend(folder.files().map(|(_, file)| (file.digest, file.bytes)));
        }
        Ok(all)
    }

    /// True where the list of a folder and all its files exist in full length.
    pub(super) fn has_folder(&self, digest: &Digest) -> Result<bool, StoreError> {
        let Some(folder) = self.folder(digest)? else { return Ok(false) };
        for (_, file) in folder.files() {
            if !self.has_blob(&file.digest, file.bytes)? {
                return Ok(false);
            }
        }
        Ok(true)
    }

    /// As [`Store::folder`], for one that a stage needs.
    pub(super) fn folder_to_read(&self, digest: &Digest) -> Result<Folder, StoreError> {
        self.folder(digest)?.ok_or_else(|| StoreError::Missing(self.blob_path(digest)))
    }

    /// Creates the folder with this digest at `to`, from links to the blobs. For built-in stages, which never write to an input;
    /// see [`Store::copy_out_folder`] for programs.
    ///
    /// # Errors
    /// A part of it is no longer in the store, or `to` cannot be written.
    pub fn lay_out(&self, digest: &Digest, to: &Path) -> Result<(), StoreError> {
        let folder = self.folder_to_read(digest)?;
        fsx::create_dir_all(to)?;
        for FolderEntry { path, what } in folder.entries() {
            match what {
                Part::File(file) => fsx::put(&self.blob_path(&file.digest), &to.join(path), file.executable)?,
                Part::Empty => fsx::create_dir_all(&to.join(path))?,
                Part::Link(target) => fsx::symlink_into(target, &to.join(path))?,
            }
        }
        Ok(())
    }
}

#[cfg(test)]
#[path = "folder_tests.rs"]
mod tests;
