//! Symbolic links: made, read, and put out of the way.

use std::path::{Path, PathBuf};

use super::{FsError, Result, copy_atomic, create_dir_all};

/// Makes a symbolic link at `at` that leads to `to`.
pub fn symlink(to: &Path, at: &Path) -> Result<()> {
    std::os::unix::fs::symlink(to, at).map_err(FsError::at("create a link at", at))
}

/// As [`symlink`], and makes the folder that `at` lies in.
pub fn symlink_into(to: &Path, at: &Path) -> Result<()> {
    if let Some(folder) = at.parent() {
        create_dir_all(folder)?;
    }
    symlink(to, at)
}

/// Puts a copy of the file that a symbolic link leads to in the link's place; a file stays as it is.
///
/// # Errors
/// It cannot be read, or not be written.
pub fn be_a_file(path: &Path) -> Result<()> {
    let meta = std::fs::symlink_metadata(path).map_err(FsError::at("access", path))?;
    if meta.is_symlink() { copy_atomic(path, path) } else { Ok(()) }
}

/// Where a symbolic link leads; `None` where there is none or it cannot be read.
pub fn link_target(path: &Path) -> Option<PathBuf> {
    std::fs::read_link(path).ok()
}

/// The path without links in it; `None` where there is no such path.
pub fn real(path: &Path) -> Option<PathBuf> {
    path.canonicalize().ok()
}
