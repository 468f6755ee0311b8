//! Files, with the path in every error. The only user of `std::fs` in the engine, so that what touches the disk, and in
//! which order it becomes durable, can be read in one place.

use std::fs::{File, OpenOptions};
use std::io::{self, Read, Write};
use std::path::{Path, PathBuf};

/// What was tried on which path, and the system's answer.
#[derive(Debug, thiserror::Error)]
#[error("cannot {action} `{path}`: {source}", path = path.display())]
pub struct FsError {
    /// What was tried, as in "read".
    pub action: &'static str,
    /// On what.
    pub path: PathBuf,
    /// The system's answer.
    pub source: io::Error,
}

impl FsError {
    /// For `map_err` on an operation on `path`.
    pub fn at(action: &'static str, path: &Path) -> impl FnOnce(io::Error) -> Self {
        let path = path.to_owned();
        move |source| Self { action, path, source }
    }

    /// True where the path does not exist.
    pub fn is_not_found(&self) -> bool {
        self.source.kind() == io::ErrorKind::NotFound
    }
}

/// The result of an operation on a file.
pub type Result<T> = std::result::Result<T, FsError>;

/// What is at a path, links not followed.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Entry {
    /// A regular file of so many bytes.
    File(u64),
    /// A folder.
    Folder,
    /// A symbolic link, device, pipe or socket.
    Other,
}

/// What is at `path`; `None` where nothing is.
///
/// # Errors
/// It cannot be looked at.
pub fn entry(path: &Path) -> Result<Option<Entry>> {
    match std::fs::symlink_metadata(path) {
        Ok(meta) if meta.is_file() => Ok(Some(Entry::File(meta.len()))),
        Ok(meta) if meta.is_dir() => Ok(Some(Entry::Folder)),
        Ok(_) => Ok(Some(Entry::Other)),
        Err(error) if error.kind() == io::ErrorKind::NotFound => Ok(None),
        Err(error) => Err(FsError::at("look at", path)(error)),
    }
}

/// The whole file; `None` where there is none.
///
/// # Errors
/// It is there and cannot be read.
pub fn read_if_there(path: &Path) -> Result<Option<Vec<u8>>> {
    match std::fs::read(path) {
        Ok(bytes) => Ok(Some(bytes)),
        Err(error) if error.kind() == io::ErrorKind::NotFound => Ok(None),
        Err(error) => Err(FsError::at("read", path)(error)),
    }
}

/// The whole file.
///
/// # Errors
/// It cannot be read.
pub fn read(path: &Path) -> Result<Vec<u8>> {
    std::fs::read(path).map_err(FsError::at("read", path))
}

/// The whole file, which must be UTF-8.
///
/// # Errors
/// It cannot be read, or is not UTF-8.
pub fn read_to_string(path: &Path) -> Result<String> {
    std::fs::read_to_string(path).map_err(FsError::at("read", path))
}

/// Opens a file for reading.
///
/// # Errors
/// It cannot be opened.
pub fn open(path: &Path) -> Result<File> {
    File::open(path).map_err(FsError::at("open", path))
}

/// Opens a file for appending, making it where there is none.
///
/// # Errors
/// It cannot be opened.
pub fn open_append(path: &Path) -> Result<File> {
    OpenOptions::new().append(true).create(true).open(path).map_err(FsError::at("open", path))
}

/// Makes a folder and those above it; one that is there is fine.
///
/// # Errors
/// It cannot be made.
pub fn create_dir_all(path: &Path) -> Result<()> {
    std::fs::create_dir_all(path).map_err(FsError::at("make the folder", path))
}

/// Removes a file; true where there was one.
///
/// # Errors
/// It is there and cannot be removed.
pub fn remove_file(path: &Path) -> Result<bool> {
    match std::fs::remove_file(path) {
        Ok(()) => Ok(true),
        Err(error) if error.kind() == io::ErrorKind::NotFound => Ok(false),
        Err(error) => Err(FsError::at("remove", path)(error)),
    }
}

/// Removes a folder and all that is in it; one that is not there is fine.
///
/// # Errors
/// It is there and cannot be removed.
pub fn remove_dir_all(path: &Path) -> Result<()> {
    match std::fs::remove_dir_all(path) {
        Err(error) if error.kind() != io::ErrorKind::NotFound => {
            Err(FsError::at("remove the folder", path)(error))
        }
        _ => Ok(()),
    }
}

/// The names in a folder, sorted; empty where there is no folder.
///
/// # Errors
/// It cannot be listed.
pub fn list(path: &Path) -> Result<Vec<PathBuf>> {
    let entries = match std::fs::read_dir(path) {
        Ok(entries) => entries,
        Err(error) if error.kind() == io::ErrorKind::NotFound => return Ok(Vec::new()),
        Err(error) => return Err(FsError::at("list", path)(error)),
    };
    let mut found = Vec::new();
    for entry in entries {
        found.push(entry.map_err(FsError::at("list", path))?.path());
    }
    found.sort();
    Ok(found)
}

/// Moves `from` to `to`, over what is there.
///
/// # Errors
/// It cannot be moved.
pub fn rename(from: &Path, to: &Path) -> Result<()> {
    std::fs::rename(from, to).map_err(FsError::at("move a file to", to))
}

/// Makes the file durable.
///
/// # Errors
/// The disk refuses.
pub fn sync(file: &File, path: &Path) -> Result<()> {
    file.sync_all().map_err(FsError::at("sync", path))
}

/// Makes names in a folder durable.
///
/// # Errors
/// The disk refuses.
pub fn sync_dir(path: &Path) -> Result<()> {
    sync(&open(path)?, path)
}

/// Writes a file so that it is there in full or not at all, also after a power failure: a temporary file beside it,
/// synced, then renamed over what is there.
///
/// # Errors
/// It cannot be written; what was there is still there.
pub fn write_atomic(path: &Path, bytes: &[u8]) -> Result<()> {
    place(path, |file| file.write_all(bytes))
}

/// Copies `from` to `to` so that `to` is there in full or not at all.
///
/// # Errors
/// `from` cannot be read or `to` cannot be written.
pub fn copy_atomic(from: &Path, to: &Path) -> Result<()> {
    let mut source = open(from)?;
    place(to, |file| io::copy(&mut source, file).map(drop))
}

fn place(path: &Path, fill: impl FnOnce(&mut File) -> io::Result<()>) -> Result<()> {
    let folder = path.parent().filter(|folder| !folder.as_os_str().is_empty()).unwrap_or(Path::new("."));
    let mut temporary = tempfile::Builder::new()
        .prefix(".tmp-")
        .tempfile_in(folder)
        .map_err(FsError::at("write in", folder))?;
    fill(temporary.as_file_mut()).map_err(FsError::at("write", path))?;
    sync(temporary.as_file(), path)?;
    temporary.persist(path).map_err(|error| FsError::at("write", path)(error.error))?;
    sync_dir(folder)
}

/// The last lines of a text file: at most `lines`, read from at most the last 64 KiB.
///
/// # Errors
/// It cannot be read.
pub fn tail(path: &Path, lines: usize) -> Result<Vec<String>> {
    use std::io::{Seek, SeekFrom};
    const WINDOW: u64 = 64 * 1024;
    let mut file = open(path)?;
    let length = file.metadata().map_err(FsError::at("read", path))?.len();
    file.seek(SeekFrom::Start(length.saturating_sub(WINDOW))).map_err(FsError::at("read", path))?;
    let mut bytes = Vec::new();
    file.read_to_end(&mut bytes).map_err(FsError::at("read", path))?;
    let text = String::from_utf8_lossy(&bytes);
    let all: Vec<&str> = text.lines().collect();
    Ok(all[all.len().saturating_sub(lines)..].iter().map(|line| (*line).to_owned()).collect())
}
