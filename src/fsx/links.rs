//! Links: made, read, and put out of the way.

use std::io::ErrorKind;
use std::os::unix::fs::MetadataExt;
use std::path::{Path, PathBuf};
use std::sync::Once;

use rustix::process::{Pid, geteuid, test_kill_process};

use super::{FsError, Result, copy_atomic, create_dir, create_dir_all};

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

/// Gives the private file or folder `from` a second name, `to`: a file gets a hard link, a folder is made again from its folders,
/// symbolic links and hard links to its files. Where the file system has no hard links, files become symbolic links.
///
/// # Errors
/// `from` cannot be read, or `to` not be made.
pub fn link_tree(from: &Path, to: &Path) -> Result<()> {
    let mut open = vec![(from.to_owned(), to.to_owned())];
    while let Some((from, to)) = open.pop() {
        let meta = std::fs::symlink_metadata(&from).map_err(FsError::at("access", &from))?;
        if meta.is_dir() {
            create_dir(&to)?;
            for path in super::list(&from)? {
                let at = to.join(path.file_name().unwrap_or_default());
                open.push((path, at));
            }
        } else if let Some(target) = link_target(&from).filter(|_| meta.is_symlink()) {
            symlink(&target, &to)?;
        } else if std::fs::hard_link(&from, &to).is_err() {
            symlink(&from, &to)?;
        }
    }
    Ok(())
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

/// A symbolic link that is removed when this is dropped.
#[derive(Debug)]
pub struct TemporaryLink(tempfile::TempPath);

impl TemporaryLink {
    /// Where it is.
    pub fn path(&self) -> &Path {
        &self.0
    }
}

/// The start of the names of temporary links; the number of their process follows.
const TEMPORARY: &str = "dril-";
/// A longer folder for temporary files is not used for them: they are there to be short.
const LONGEST: usize = 32;

/// Makes a short path to the absolute path `to`: a link with a name of its own in the folder for temporary files. The first call
/// removes those of dead processes, since on a node of a cluster nothing else does. `None` where no link can be made.
pub fn temporary_link(to: &Path) -> Option<TemporaryLink> {
    static ONCE: Once = Once::new();
    ONCE.call_once(remove_dead_links);
    let prefix = format!("{TEMPORARY}{}-", std::process::id());
    let make = |at: &Path| std::os::unix::fs::symlink(to, at);
    let made = tempfile::Builder::new().prefix(&prefix).make_in(links_folder(), make).ok()?;
    Some(TemporaryLink(made.into_temp_path()))
}

/// The folder of temporary links.
fn links_folder() -> PathBuf {
    let usual = std::env::temp_dir();
    let short = usual.is_absolute() && usual.as_os_str().len() <= LONGEST;
    if short { usual } else { PathBuf::from("/tmp") }
}

/// Removes this user's temporary links whose process is dead and whose folder is gone. A dying stage may still use the folder, and
/// a process of a container that shares only `/tmp` looks dead. What cannot be removed stays.
pub fn remove_dead_links() {
    remove_dead_links_in(&links_folder());
}

fn remove_dead_links_in(folder: &Path) {
    let own = geteuid().as_raw();
    for path in super::list(folder).unwrap_or_default() {
        let name = path.file_name().and_then(|name| name.to_str()?.strip_prefix(TEMPORARY));
        let owner = name.and_then(|name| name.split('-').next()?.parse().ok());
        let Some(owner) = owner else { continue };
        let is_own = path.symlink_metadata().is_ok_and(|meta| meta.is_symlink() && meta.uid() == own);
        let is_gone = || std::fs::metadata(&path).is_err_and(|error| error.kind() == ErrorKind::NotFound);
        if is_own && is_gone() && is_dead(owner) {
            let _ = super::remove_file(&path);
        }
    }
}

/// True where that process is dead. This one counts as dead, too: its own links lead to folders that exist, and in a container a
/// new engine often has the number of the one before.
fn is_dead(process: i32) -> bool {
    let Some(pid) = Pid::from_raw(process) else { return false };
    u32::try_from(process) == Ok(std::process::id()) || test_kill_process(pid) == Err(rustix::io::Errno::SRCH)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn only_links_of_dead_processes_to_folders_that_are_gone_are_removed() {
        let folder = tempfile::tempdir().unwrap();
        let here = folder.path();
        let ended = std::process::Command::new("true").spawn().and_then(|mut child| {
            let id = child.id();
            child.wait().map(|_| id)
        });
        let (dead, own, parent) = (ended.unwrap(), std::process::id(), std::os::unix::process::parent_id());
        let make = |name: &str, to: &str| symlink(&here.join(to), &here.join(name)).unwrap();
        std::fs::create_dir(here.join("work")).unwrap();
        for (owner, kept) in [(dead, "dead"), (own, "own"), (parent, "living")] {
            make(&format!("dril-{owner}-{kept}-there"), "work");
            make(&format!("dril-{owner}-{kept}-gone"), "nowhere");
        }
        make(&format!("other-{dead}-gone"), "nowhere");
        make("dril-x", "nowhere");
        std::fs::write(here.join(format!("dril-{dead}-a-file")), "").unwrap();
        remove_dead_links_in(here);
        let names = super::super::list(here).unwrap();
        let names: Vec<_> = names.iter().filter_map(|path| path.file_name()?.to_str()).collect();
        let count = |part: &str| names.iter().filter(|name| name.ends_with(part)).count();
        assert_eq!((count("dead-gone"), count("own-gone"), count("living-gone")), (0, 0, 1), "{names:?}");
        assert_eq!((count("-there"), count("-a-file"), names.len()), (3, 1, 8), "{names:?}");
    }
}
