//! Removes folders with all that is in them, whatever permissions they have and however deep they are: programs leave folders that
//! they made read-only, and trees deeper than a path is long or a process may have open files.

use std::ffi::CString;
use std::io;
use std::os::fd::{AsFd, AsRawFd, OwnedFd};
use std::os::unix::fs::PermissionsExt;
use std::path::Path;

use rustix::fs::{AtFlags, CWD, Dir, Mode, OFlags, fstat, openat, renameat, unlinkat};
use rustix::io::Errno;

use super::fault::step;
use super::{Result, if_there};

/// Removes a folder with its contents; a missing one is fine.
///
/// # Errors
/// It is there and cannot be removed: it, or something in it, belongs to another user.
pub fn remove_dir_all(path: &Path) -> Result<()> {
    step("remove", path)?;
    let removed = match std::fs::remove_dir_all(path) {
        Err(error) if error.kind() != io::ErrorKind::NotFound => dismantle(path),
        result => result,
    };
    if_there("remove the folder", path, removed).map(drop)
}

/// Removes a folder level by level: whatever is in a folder in it is moved up into it, and the folders that are then empty are
/// removed. So no path is longer than two names, and only two folders are open. Links are not followed, not even those that
/// another process puts in the place of a folder meanwhile.
fn dismantle(root: &Path) -> io::Result<()> {
    let top = open(CWD, root)?;
    let mut moved = 0_u64;
    loop {
        let names = listed(&top)?;
        if names.is_empty() {
            break;
        }
        for name in names {
            if !is_folder(&top, &name)? {
                continue;
            }
            let folder = open(&top, &*name)?;
            for inside in listed(&folder)? {
                if is_folder(&folder, &inside)? {
                    // Moving a folder changes its `..`, so it must be writable itself.
                    drop(open(&folder, &*inside)?);
                    moved += 1;
                    renameat(&folder, &*inside, &top, format!(".removed-{}-{moved}", std::process::id()))?;
                }
            }
            unlinkat(&top, &*name, AtFlags::REMOVEDIR)?;
        }
    }
    std::fs::remove_dir(root)
}

/// Removes a file; true where it is a folder instead, which stays.
fn is_folder(above: &OwnedFd, name: &CString) -> io::Result<bool> {
    match unlinkat(above, &**name, AtFlags::empty()) {
        Ok(()) => Ok(false),
        // POSIX says PERM for a folder, Linux says ISDIR.
        Err(Errno::ISDIR | Errno::PERM) => Ok(true),
        Err(error) => Err(error.into()),
    }
}

/// Opens a folder, and gives its owner all permissions on it first.
fn open(above: impl AsFd, name: impl rustix::path::Arg) -> io::Result<OwnedFd> {
    let flags = OFlags::DIRECTORY | OFlags::CLOEXEC;
    let handle = openat(above, name, flags | OFlags::PATH | OFlags::NOFOLLOW, Mode::empty())?;
    let mode = fstat(&handle)?.st_mode;
    if mode & 0o700 != 0o700 {
        // A descriptor of this kind has no `fchmod`, and a path could be another folder by now.
        let path = format!("/proc/self/fd/{}", handle.as_raw_fd());
        std::fs::set_permissions(path, std::fs::Permissions::from_mode(mode & 0o7777 | 0o700))?;
    }
    Ok(openat(&handle, ".", flags | OFlags::RDONLY, Mode::empty())?)
}

fn listed(folder: &OwnedFd) -> io::Result<Vec<CString>> {
    let mut names = Vec::new();
    for entry in Dir::read_from(folder)? {
        let name = entry?.file_name().to_owned();
        if !matches!(name.to_bytes(), b"." | b"..") {
            names.push(name);
        }
    }
    Ok(names)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_folder_is_dismantled_whatever_is_in_it_and_links_are_not_followed() {
        let place = tempfile::tempdir().unwrap();
        let (root, outside) = (place.path().join("root"), place.path().join("outside"));
        std::fs::create_dir_all(&outside).unwrap();
        std::fs::write(outside.join("kept"), "x").unwrap();
        std::fs::create_dir(&root).unwrap();
        dismantle(&root).unwrap();
        for folder in ["a/b/c", "a/b2", "d"] {
            std::fs::create_dir_all(root.join(folder)).unwrap();
            std::fs::write(root.join(folder).join("file"), "x").unwrap();
            std::os::unix::fs::symlink(&outside, root.join(folder).join("link")).unwrap();
        }
        for folder in ["a/b/c", "a/b", "a", ""] {
            std::fs::set_permissions(root.join(folder), std::fs::Permissions::from_mode(0o000)).unwrap();
        }
        dismantle(&root).unwrap();
        assert!(!root.exists() && outside.join("kept").exists());
        assert!(remove_dir_all(&root).is_ok(), "a missing one is fine");
    }

    #[test]
    fn a_folder_of_three_thousand_levels_is_removed() {
        let place = tempfile::tempdir().unwrap();
        let root = place.path().join("root");
        std::fs::create_dir(&root).unwrap();
        let mut at = open(CWD, &root).unwrap();
        for _ in 0..3000 {
            rustix::fs::mkdirat(&at, "d", Mode::from_raw_mode(0o755)).unwrap();
            at = open(&at, "d").unwrap();
        }
        drop(at);
        remove_dir_all(&root).unwrap();
        assert!(!root.exists());
    }
}
