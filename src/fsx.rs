//! File operations with the path in every error. This is the only user of `std::fs` in the engine, so that everything that touches
//! the disk, and the order in which it becomes durable, is in one place.

mod clock;
mod copies;
mod dir;
pub mod doctor;
pub mod fault;
mod folder;
mod heartbeat;
mod host;
mod lease;
mod lease_file;
mod links;
mod lock;
mod remove;
mod tail;
mod writable;

pub use std::fs::File;
use std::fs::{OpenOptions, Permissions};
use std::io::{self, BufRead, Read, Write};
use std::os::unix::fs::{MetadataExt, PermissionsExt};
use std::path::{Path, PathBuf};

pub use copies::{Made, clone_file, copy_with_mode, is_in_other_hands};
pub use dir::{Dir, rename_new};
use fault::step;
pub use folder::{
    Inside, Links, Outside, Stat, What, holds_at_most, is_plain_target, newest, nothing, outside, own_above,
    put, relative, settle_links, walk,
};
pub use lease_file::RUN as RUN_PATIENCE;
pub use links::{
    TemporaryLink, be_a_file, link_target, link_tree, real, remove_dead_links, symlink, symlink_into,
    temporary_link,
};
pub use lock::{Lock, announced};
pub use remove::remove_dir_all;
pub use tail::{each_line, tail};
pub use writable::{can_be_folder, can_be_written};

/// An operation failed: what was tried on which path, and the system's error.
#[derive(Debug, thiserror::Error)]
#[error("cannot {action} `{path}`: {source}", path = path.display())]
pub struct FsError {
    /// What was tried, as in "read".
    pub action: &'static str,
    /// The path.
    pub path: PathBuf,
    /// The system's error.
    pub source: io::Error,
}

impl FsError {
    /// For `map_err` on an operation on `path`.
    pub fn at(action: &'static str, path: &Path) -> impl FnOnce(io::Error) -> Self {
        move |source| Self { action, path: path.to_owned(), source }
    }

    /// True where the path does not exist.
    pub fn is_not_found(&self) -> bool {
        self.source.kind() == io::ErrorKind::NotFound
    }
}

/// The result of an operation on a file.
pub type Result<T> = std::result::Result<T, FsError>;

/// `None` for a path that does not exist.
fn if_there<T>(action: &'static str, path: &Path, result: io::Result<T>) -> Result<Option<T>> {
    match result {
        Ok(value) => Ok(Some(value)),
        Err(error) if error.kind() == io::ErrorKind::NotFound => Ok(None),
        Err(error) => Err(FsError::at(action, path)(error)),
    }
}

/// The type of a file, links not followed.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Entry {
    /// A regular file with its size in bytes.
    File(u64),
    /// A folder.
    Folder,
    /// A symbolic link, device, pipe or socket.
    Other,
}

/// The type of the file at `path`; `None` where there is none.
pub fn entry(path: &Path) -> Result<Option<Entry>> {
    let meta = if_there("access", path, std::fs::symlink_metadata(path))?;
    Ok(meta.map(|meta| match meta {
        meta if meta.is_file() => Entry::File(meta.len()),
        meta if meta.is_dir() => Entry::Folder,
        _ => Entry::Other,
    }))
}

/// The absolute form of a path, which need not exist; the path itself where the current folder is unknown.
pub fn absolute(path: &Path) -> PathBuf {
    std::path::absolute(path).unwrap_or_else(|_| path.to_owned())
}

/// True where an open file is a pipe.
pub fn is_pipe(file: &impl std::os::fd::AsFd) -> bool {
    rustix::fs::fstat(file)
        .is_ok_and(|stat| rustix::fs::FileType::from_raw_mode(stat.st_mode) == rustix::fs::FileType::Fifo)
}

/// Reads a file; `None` where there is none.
///
/// # Errors
/// It is there and cannot be read.
pub fn read_if_there(path: &Path) -> Result<Option<Vec<u8>>> {
    if_there("read", path, std::fs::read(path))
}

/// Reads a file.
pub fn read(path: &Path) -> Result<Vec<u8>> {
    std::fs::read(path).map_err(FsError::at("read", path))
}

/// The modification time of a file; `None` where there is none.
pub fn modified(path: &Path) -> Result<Option<std::time::SystemTime>> {
    let Some(meta) = if_there("access", path, std::fs::symlink_metadata(path))? else { return Ok(None) };
    meta.modified().map(Some).map_err(FsError::at("access", path))
}

/// Identifies a file and its state: device, inode, size and times.
pub fn identity(path: &Path) -> Result<String> {
    let meta = std::fs::metadata(path).map_err(FsError::at("access", path))?;
    let (modified, changed) = ((meta.mtime(), meta.mtime_nsec()), (meta.ctime(), meta.ctime_nsec()));
    Ok(format!("{}:{}:{}:{modified:?}:{changed:?}", meta.dev(), meta.ino(), meta.len()))
}

/// True where a file is writable for anybody.
pub fn is_writable(path: &Path) -> Result<bool> {
    let meta = std::fs::symlink_metadata(path).map_err(FsError::at("access", path))?;
    Ok(meta.permissions().mode() & 0o222 != 0)
}

/// True where a file is executable for anybody.
pub fn is_executable(path: &Path) -> Result<bool> {
    let meta = std::fs::symlink_metadata(path).map_err(FsError::at("access", path))?;
    Ok(meta.permissions().mode() & 0o111 != 0)
}

/// Sets the modification time of a file to now. Enough for that is the right to write the file, which may belong to another user.
pub fn touch(path: &Path) -> Result<()> {
    heartbeat::touch(path).map_err(FsError::at("touch", path))
}

/// Opens a regular file for reading.
///
/// # Errors
/// It cannot be opened, or is not a regular file.
pub fn open(path: &Path) -> Result<File> {
    let file = File::open(path).map_err(FsError::at("open", path))?;
    let meta = file.metadata().map_err(FsError::at("access", path))?;
    if meta.is_file() {
        return Ok(file);
    }
    let seen = if meta.is_dir() { "it is a folder" } else { "it is not a regular file" };
    Err(FsError::at("read", path)(io::Error::other(format!("{seen}, expected a file"))))
}

/// Makes a new file, or empties the one that is there, and opens it for writing.
///
/// # Errors
/// It cannot be made.
pub fn create(path: &Path) -> Result<File> {
    step("write", path)?;
    File::create(path).map_err(FsError::at("write", path))
}

/// Makes a file of these bytes where nothing is yet, in one step that works on network file systems too; false where
/// something is.
///
/// # Errors
/// It cannot be made.
pub fn create_exclusive(path: &Path, bytes: &[u8]) -> Result<bool> {
    step("write", path)?;
    match OpenOptions::new().write(true).create_new(true).open(path) {
        Ok(mut file) => write_all(&mut file, path, bytes).map(|()| true),
        Err(error) if error.kind() == io::ErrorKind::AlreadyExists => Ok(false),
        Err(error) => Err(FsError::at("make", path)(error)),
    }
}

/// Opens a file for appending; creates it where there is none.
pub fn open_append(path: &Path) -> Result<File> {
    step("append", path)?;
    OpenOptions::new().append(true).create(true).open(path).map_err(FsError::at("open", path))
}

/// Appends to a file in one call; creates it where there is none.
pub fn append(path: &Path, bytes: &[u8]) -> Result<()> {
    write_all(&mut open_append(path)?, path, bytes)
}

/// Creates a folder, which must not exist.
///
/// # Errors
/// It exists, or cannot be created.
pub fn create_dir(path: &Path) -> Result<()> {
    step("make", path)?;
    std::fs::create_dir(path).map_err(FsError::at("create the folder", path))
}

/// Creates a folder and its parents; an existing one is fine.
pub fn create_dir_all(path: &Path) -> Result<()> {
    step("make", path)?;
    std::fs::create_dir_all(path).map_err(FsError::at("create the folder", path))
}

/// Makes network file systems forget what they know of a folder, which may be out of date: it is changed. Creates it where there is
/// none.
///
/// # Errors
/// It cannot be written.
pub fn refresh(folder: &Path) -> Result<()> {
    create_dir_all(folder)?;
    let file = tempfile::Builder::new().prefix(".tmp-").tempfile_in(folder);
    file.map(drop).map_err(FsError::at("write in", folder))
}

/// Removes a file; true where there was one.
///
/// # Errors
/// It is there and cannot be removed.
pub fn remove_file(path: &Path) -> Result<bool> {
    step("remove", path)?;
    Ok(if_there("remove", path, std::fs::remove_file(path))?.is_some())
}

/// The paths in a folder, sorted; empty where there is no folder.
pub fn list(path: &Path) -> Result<Vec<PathBuf>> {
    let Some(entries) = if_there("list", path, std::fs::read_dir(path))? else { return Ok(Vec::new()) };
    let mut found = Vec::new();
    for entry in entries {
        found.push(entry.map_err(FsError::at("list", path))?.path());
    }
    found.sort();
    Ok(found)
}

/// Moves `from` to `to`, replacing an existing file.
pub fn rename(from: &Path, to: &Path) -> Result<()> {
    step("rename", to)?;
    std::fs::rename(from, to).map_err(FsError::at("move a file to", to))
}

/// As [`rename`]; creates the folder of `to` if it is missing. True where it was missing.
pub fn rename_into(from: &Path, to: &Path) -> Result<bool> {
    match (rename(from, to), to.parent()) {
        (Err(error), Some(folder)) if error.is_not_found() => {
            create_dir_all(folder)?;
            rename(from, to).map(|()| true)
        }
        (result, _) => result.map(|()| false),
    }
}

/// Size, and time of the last change in nanoseconds, of a regular file, links followed; `None` for anything else.
pub fn stamp(path: &Path) -> Option<(u64, i128)> {
    let meta = std::fs::metadata(path).ok().filter(std::fs::Metadata::is_file)?;
    Some((meta.len(), i128::from(meta.mtime()) * 1_000_000_000 + i128::from(meta.mtime_nsec())))
}

/// Makes a file read-only for everybody.
///
/// # Errors
/// It belongs to another user.
pub fn make_read_only(file: &File, path: &Path) -> Result<()> {
    step("chmod", path)?;
    file.set_permissions(Permissions::from_mode(0o444)).map_err(FsError::at("make read-only", path))
}

/// Makes the file durable.
pub fn sync(file: &File, path: &Path) -> Result<()> {
    step("sync", path)?;
    file.sync_all().map_err(FsError::at("sync", path))
}

/// Makes the names in a folder durable.
pub fn sync_dir(path: &Path) -> Result<()> {
    sync(&File::open(path).map_err(FsError::at("open", path))?, path)
}

/// Writes a new file, which may not survive a power failure.
pub fn write(path: &Path, bytes: &[u8]) -> Result<()> {
    step("write", path)?;
    write_all(&mut File::create(path).map_err(FsError::at("write", path))?, path, bytes)
}

/// As [`write`], a file that only its owner may read.
pub fn write_private(path: &Path, bytes: &[u8]) -> Result<()> {
    use std::os::unix::fs::OpenOptionsExt;
    step("write", path)?;
    let opened = OpenOptions::new().write(true).create(true).truncate(true).mode(0o600).open(path);
    write_all(&mut opened.map_err(FsError::at("write", path))?, path, bytes)
}

/// Replaces the content of a file in place, without a new file; creates it where there is none. Short contents only: a reader may
/// see half of a long one.
///
/// # Errors
/// It cannot be written.
pub fn overwrite(path: &Path, bytes: &[u8]) -> Result<()> {
    step("write", path)?;
    let opened = OpenOptions::new().write(true).create(true).truncate(false).open(path);
    let mut file = opened.map_err(FsError::at("write", path))?;
    file.write_all(bytes).map_err(FsError::at("write", path))?;
    file.set_len(bytes.len() as u64).map_err(FsError::at("write", path))
}

/// Writes a new file and makes its content durable.
pub fn write_synced(path: &Path, bytes: &[u8]) -> Result<()> {
    step("write", path)?;
    let mut file = File::create(path).map_err(FsError::at("write", path))?;
    write_all(&mut file, path, bytes)?;
    sync(&file, path)
}

/// Writes a file atomically, also with respect to power failures: writes a temporary file beside it, syncs it, and renames it.
///
/// # Errors
/// It cannot be written; the old file is unchanged.
pub fn write_atomic(path: &Path, bytes: &[u8]) -> Result<()> {
    place(path, |file| write_all(file, path, bytes))
}

/// As [`write_atomic`], with content that `fill` writes.
///
/// # Errors
/// It cannot be written, or `fill` fails; the old file is unchanged.
pub fn fill_atomic(path: &Path, fill: impl FnOnce(&mut File) -> Result<()>) -> Result<()> {
    place(path, fill)
}

/// Writes everything from `from` to the new file `path`, which may not survive a power failure. Returns the number of bytes.
///
/// # Errors
/// `from` cannot be read or `path` cannot be written.
pub fn write_from(path: &Path, mut from: impl Read) -> Result<u64> {
    step("write", path)?;
    let mut file = File::create(path).map_err(FsError::at("write", path))?;
    io::copy(&mut from, &mut file).map_err(FsError::at("write", path))
}

/// Copies `from` to `to` atomically.
///
/// # Errors
/// `from` cannot be read or `to` cannot be written.
pub fn copy_atomic(from: &Path, to: &Path) -> Result<()> {
    let mut source = open(from)?;
    place(to, |file| io::copy(&mut source, file).map(drop).map_err(FsError::at("write", to)))
}

/// Copies `from` to the new file `to`, which may not survive a power failure.
///
/// # Errors
/// `from` cannot be read or `to` cannot be written.
pub fn copy(from: &Path, to: &Path) -> Result<()> {
    copy_from(&mut open(from)?, from, to)
}

/// Copies the open file `source`, called `name` in errors, to the new file `to`, which may not survive a power failure.
///
/// # Errors
/// `source` cannot be read or `to` cannot be written.
pub fn copy_from(source: &mut impl Read, name: &Path, to: &Path) -> Result<()> {
    step("write", to)?;
    let mut file = File::create(to).map_err(FsError::at("write", to))?;
    copies::pour(source, name, &mut file, to)
}

fn place(path: &Path, fill: impl FnOnce(&mut File) -> Result<()>) -> Result<()> {
    let folder = path.parent().filter(|folder| !folder.as_os_str().is_empty()).unwrap_or(Path::new("."));
    step("write", path)?;
    // With the user's umask, as for any new file: the library's default would hide it from other users.
    let mut temporary = tempfile::Builder::new()
        .prefix(".tmp-")
        .permissions(Permissions::from_mode(0o666))
        .tempfile_in(folder)
        .map_err(FsError::at("write in", folder))?;
    fill(temporary.as_file_mut())?;
    sync(temporary.as_file(), path)?;
    step("rename", path)?;
    temporary.persist(path).map_err(|error| FsError::at("write", path)(error.error))?;
    sync_dir(folder)
}

fn write_all(file: &mut File, path: &Path, bytes: &[u8]) -> Result<()> {
    #[cfg(debug_assertions)]
    let bytes = {
        let (first, rest) = bytes.split_at(bytes.len() / 2);
        file.write_all(first).map_err(FsError::at("write", path))?;
        step("half", path)?;
        rest
    };
    file.write_all(bytes).map_err(FsError::at("write", path))
}

/// The first byte at which two files differ, from 0; if one is a prefix of the other, its length.
pub fn first_difference(one: &Path, other: &Path) -> Result<u64> {
    let (mut first, mut second) = (io::BufReader::new(open(one)?), io::BufReader::new(open(other)?));
    let mut at = 0;
    loop {
        let a = first.fill_buf().map_err(FsError::at("read", one))?;
        let b = second.fill_buf().map_err(FsError::at("read", other))?;
        let both = a.len().min(b.len());
        if let Some(here) = a.iter().zip(b).position(|(a, b)| a != b) {
            return Ok(at + here as u64);
        }
        if both == 0 {
            return Ok(at);
        }
        at += both as u64;
        first.consume(both);
        second.consume(both);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_error_says_what_was_tried_on_which_path() {
        let folder = tempfile::tempdir().unwrap();
        let missing = folder.path().join("missing");
        let text = read(&missing).unwrap_err().to_string();
        assert!(text.starts_with(&format!("cannot read `{}`: ", missing.display())), "{text}");
        let text = open(folder.path()).unwrap_err().to_string();
        assert!(text.ends_with("it is a folder, expected a file"), "{text}");
    }

    #[test]
    fn an_atomic_write_replaces_the_file_and_leaves_nothing_beside_it() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("file");
        write_atomic(&path, b"old").unwrap();
        write_atomic(&path, b"new").unwrap();
        assert_eq!(read(&path).unwrap(), b"new");
        assert_eq!(list(folder.path()).unwrap(), [path]);
    }

    #[test]
    fn a_failed_copy_leaves_what_was_there() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("file");
        write_atomic(&path, b"old").unwrap();
        assert!(copy_atomic(&folder.path().join("missing"), &path).is_err());
        assert_eq!(read(&path).unwrap(), b"old");
    }

    #[test]
    fn a_link_is_no_file() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("link");
        std::os::unix::fs::symlink("/etc/hostname", &path).unwrap();
        assert_eq!(entry(&path).unwrap(), Some(Entry::Other));
        assert_eq!(entry(&folder.path().join("missing")).unwrap(), None);
    }
}
