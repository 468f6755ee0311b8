//! What is in a folder, all the way down, and what tells one state of a file from the next.

use std::fs::Metadata;
use std::io;
use std::os::unix::fs::{MetadataExt, PermissionsExt};
use std::path::{Path, PathBuf};

use super::{FsError, Result, create_dir_all, step};

/// Folders inside each other; deeper is a slip, such as a folder that holds a copy of itself.
const DEEPEST: usize = 200;

/// What a file system says of a file. While all of it stays the same, so does the content, but for a change within the
/// grain of its clock.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Stat {
    /// The device.
    pub device: u64,
    /// The file's number on it.
    pub inode: u64,
    /// Bytes.
    pub bytes: u64,
    /// The last change of the content, in nanoseconds since 1970.
    pub modified: i64,
    /// The last change of anything about it, in nanoseconds since 1970; no program can set it.
    pub changed: i64,
    /// True where somebody may execute it.
    pub executable: bool,
}

impl Stat {
    fn of(meta: &Metadata) -> Self {
        let nanoseconds =
            |seconds: i64, rest: i64| seconds.saturating_mul(1_000_000_000).saturating_add(rest);
        Self {
            device: meta.dev(),
            inode: meta.ino(),
            bytes: meta.len(),
            modified: nanoseconds(meta.mtime(), meta.mtime_nsec()),
            changed: nanoseconds(meta.ctime(), meta.ctime_nsec()),
            executable: meta.permissions().mode() & 0o111 != 0,
        }
    }
}

/// True where the files in a folder, all the way down, have at most so many bytes; false where that cannot be seen.
pub fn holds_at_most(folder: &Path, bytes: u64) -> bool {
    left_of(folder, bytes, 0).is_some()
}

fn left_of(folder: &Path, bytes: u64, depth: usize) -> Option<u64> {
    let mut left = bytes;
    for entry in std::fs::read_dir(folder).ok()? {
        let entry = entry.ok().filter(|_| depth < DEEPEST)?;
        let kind = entry.file_type().ok()?;
        if kind.is_dir() {
            left = left_of(&entry.path(), left, depth + 1)?;
        } else if kind.is_file() {
            left = left.checked_sub(entry.metadata().ok()?.len())?;
        }
    }
    Some(left)
}

/// What is at a path from outside, links followed.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Outside {
    /// A regular file.
    File(Stat),
    /// A folder.
    Folder,
}

/// Looks at a path from outside.
///
/// # Errors
/// It is not there, or neither a file nor a folder.
pub fn outside(path: &Path) -> Result<Outside> {
    let meta = std::fs::metadata(path).map_err(FsError::at("read", path))?;
    if meta.is_file() {
        Ok(Outside::File(Stat::of(&meta)))
    } else if meta.is_dir() {
        Ok(Outside::Folder)
    } else {
        Err(refuse(path, "it is neither a file nor a folder"))
    }
}

/// Something in a folder.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Inside {
    /// Its path, relative to the folder.
    pub path: PathBuf,
    /// A file; `None` for a folder in which there is nothing.
    pub file: Option<Stat>,
}

/// What to do with a symbolic link.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Links {
    /// Its file is taken for it. A link to a folder is refused all the same: it may lead in a circle.
    Follow,
    /// It is refused.
    Refuse,
}

/// All files and empty folders below `root`, in no order that means anything.
///
/// # Errors
/// Something cannot be read, or is neither file nor folder.
pub fn walk(root: &Path, links: Links) -> Result<Vec<Inside>> {
    let mut found = Vec::new();
    let mut open = vec![(PathBuf::new(), 0)];
    while let Some((folder, depth)) = open.pop() {
        let path = root.join(&folder);
        if depth > DEEPEST {
            return Err(refuse(&path, "it is more than 200 folders deep"));
        }
        let mut empty = true;
        for entry in std::fs::read_dir(&path).map_err(FsError::at("list", &path))? {
            let entry = entry.map_err(FsError::at("list", &path))?;
            empty = false;
            let (inside, path) = (folder.join(entry.file_name()), entry.path());
            let kind = entry.file_type().map_err(FsError::at("look at", &path))?;
            if kind.is_dir() {
                open.push((inside, depth + 1));
                continue;
            }
            if kind.is_symlink() && links == Links::Refuse {
                return Err(refuse(
                    &path,
                    "it is a symbolic link, expected files and folders: copy what it leads to",
                ));
            }
            match outside(&path)? {
                Outside::File(stat) => found.push(Inside { path: inside, file: Some(stat) }),
                Outside::Folder => {
                    return Err(refuse(
                        &path,
                        "it is a link to a folder, which is not followed: name that folder",
                    ));
                }
            }
        }
        if empty && depth > 0 {
            found.push(Inside { path: folder, file: None });
        }
    }
    Ok(found)
}

fn refuse(path: &Path, why: &'static str) -> FsError {
    FsError::at("read", path)(io::Error::other(why))
}

/// Puts the read-only file `from` at `to`, which shares its content where the file system allows that. An executable one
/// is copied: the right to execute belongs to the file, not to its name.
///
/// # Errors
/// `from` is not there, or `to` cannot be made.
pub fn put(from: &Path, to: &Path, executable: bool) -> Result<()> {
    if let Some(folder) = to.parent() {
        create_dir_all(folder)?;
    }
    step("link", to)?;
    if !executable && std::fs::hard_link(from, to).is_ok() {
        return Ok(());
    }
    super::copy(from, to)?;
    let mode = if executable { 0o555 } else { 0o444 };
    let rights = std::fs::Permissions::from_mode(mode);
    std::fs::set_permissions(to, rights).map_err(FsError::at("make read-only", to))
}
