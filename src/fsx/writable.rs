//! Whether a folder could be written, found out before there is anything to write.

use std::fs::OpenOptions;
use std::io::{self, ErrorKind};
use std::path::Path;

use super::{FsError, Result};

/// Checks that there is a folder at `path`, or that one can be created there as far as its parents are concerned.
///
/// # Errors
/// Something else is in the way: the path of the error says where.
pub fn can_be_folder(path: &Path) -> Result<()> {
    nearest_folder(path).map(drop)
}

/// Checks that a file can be created in a folder, or in the folder that it would be created in. It tries, since permission bits do
/// not tell what a file system allows, and leaves nothing behind.
///
/// # Errors
/// As [`can_be_folder`], or it cannot be written.
pub fn can_be_written(folder: &Path) -> Result<()> {
    let place = nearest_folder(folder)?;
    let probe = place.join(format!(".tmp-{}-probe", std::process::id()));
    // Not exclusively: another thread may try the same, and a killed process may have left one.
    let tried = OpenOptions::new().write(true).create(true).truncate(false).open(&probe);
    tried.map_err(FsError::at("write in", place))?;
    let _ = std::fs::remove_file(&probe);
    Ok(())
}

/// The folder, or the nearest one above it that exists.
fn nearest_folder(path: &Path) -> Result<&Path> {
    let mut place = path;
    loop {
        place = if place.as_os_str().is_empty() { Path::new(".") } else { place };
        let wrong =
            |what| Err(FsError::at("write in", place)(io::Error::new(ErrorKind::NotADirectory, what)));
        match std::fs::metadata(place) {
            Ok(meta) if meta.is_dir() => return Ok(place),
            Ok(_) => return wrong("it is a file, expected a folder"),
            Err(error) if matches!(error.kind(), ErrorKind::NotFound | ErrorKind::NotADirectory) => {
                if std::fs::symlink_metadata(place).is_ok() {
                    return wrong("it is a link that leads nowhere");
                }
            }
            Err(error) => return Err(FsError::at("access", place)(error)),
        }
        match place.parent() {
            Some(parent) => place = parent,
            None => return Ok(place),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_folder_that_could_be_made_and_written_is_not_made() {
        let folder = tempfile::tempdir().unwrap();
        for path in ["", "a", "a/b/c", "a/../b"] {
            can_be_written(&folder.path().join(path)).unwrap();
            assert!(super::super::list(folder.path()).unwrap().is_empty(), "{path}");
        }
        can_be_written(Path::new("a-folder-of-no-test")).unwrap();
    }

    #[test]
    fn what_is_in_the_way_is_named() {
        let folder = tempfile::tempdir().unwrap();
        let (file, link) = (folder.path().join("file"), folder.path().join("link"));
        std::fs::write(&file, "").unwrap();
        super::super::symlink(Path::new("nowhere"), &link).unwrap();
        for (path, at, what) in [
            (file.clone(), &file, "a file"),
            (file.join("a/b"), &file, "a file"),
            (link.join("a"), &link, "a link that leads nowhere"),
        ] {
            let error = can_be_folder(&path).unwrap_err();
            assert_eq!(&error.path, at);
            assert!(error.source.to_string().contains(what), "{error}");
        }
    }
}
