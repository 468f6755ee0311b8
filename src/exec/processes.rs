//! Processes as `/proc` shows them: parent, group, start time, and whether a process uses a folder. On systems without `/proc`
//! nothing is found.

use std::path::{Path, PathBuf};

use rustix::process::Pid;

use crate::fsx;

/// A process, from `/proc/<pid>/stat`.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct Process {
    pub pid: i32,
    pub parent: i32,
    pub group: i32,
    /// Start time in clock ticks since boot.
    pub began: u64,
    /// It has ended and is not reaped.
    pub is_zombie: bool,
}

impl Process {
    /// `None` where it is gone.
    pub fn of(pid: i32) -> Option<Self> {
        Self::parse(pid, &fsx::read(&proc_folder(pid).join("stat")).ok()?)
    }

    fn parse(pid: i32, stat: &[u8]) -> Option<Self> {
        let stat = String::from_utf8_lossy(stat);
        // The program name before it may contain any character.
        let mut fields = stat.rsplit_once(')')?.1.split_whitespace();
        let is_zombie = matches!(fields.next()?, "Z" | "X");
        let (parent, group) = (fields.next()?.parse().ok()?, fields.next()?.parse().ok()?);
        // Field 22 of the manual; the parent is field 4, the group field 5.
        let began = fields.nth(16)?.parse().ok()?;
        Some(Self { pid, parent, group, began, is_zombie })
    }

    /// True where it runs in `folder`, has a file in it open, or has the folder's path in its environment, as the program of a
    /// stage does.
    pub fn belongs_to(&self, folder: &Path) -> bool {
        self.works_in(folder) || self.has_open(folder)
    }

    /// True where it runs in `folder` or has the folder's path in its environment.
    pub fn works_in(&self, folder: &Path) -> bool {
        let place = proc_folder(self.pid);
        // The last two components are the run and the key. The part before them may be written in several ways.
        let wanted = folder.as_os_str().as_encoded_bytes();
        let slashes = wanted.iter().enumerate().rev().filter(|(_, byte)| **byte == b'/');
        let wanted = &wanted[slashes.map(|(at, _)| at).nth(1).unwrap_or(0)..];
        let names_it = |bytes: Vec<u8>| bytes.windows(wanted.len()).any(|window| window == wanted);
        fsx::read(&place.join("environ")).is_ok_and(names_it) || leads_into(&place.join("cwd"), folder)
    }

    /// True where it has a file or folder in `folder` open.
    pub fn has_open(&self, folder: &Path) -> bool {
        let open = fsx::list(&proc_folder(self.pid).join("fd")).unwrap_or_default();
        open.iter().any(|link| leads_into(link, folder))
    }

    /// True where it runs the same executable file as this process.
    pub fn is_this_program(&self) -> bool {
        let own = fsx::link_target(Path::new("/proc/self/exe"));
        own.is_some() && fsx::link_target(&proc_folder(self.pid).join("exe")) == own
    }
}

fn leads_into(link: &Path, folder: &Path) -> bool {
    fsx::link_target(link).is_some_and(|to| to.starts_with(folder))
}

fn proc_folder(pid: i32) -> PathBuf {
    Path::new("/proc").join(pid.to_string())
}

/// All processes.
pub(super) fn all() -> Vec<Process> {
    let names = fsx::list(Path::new("/proc")).unwrap_or_default().into_iter();
    names.filter_map(|name| Process::of(name.file_name()?.to_str()?.parse().ok()?)).collect()
}

/// The children of this process's main thread: processes that it adopted are among them, processes that other threads started
/// are not.
pub(super) fn given_children(own: Pid) -> Vec<i32> {
    let own = own.as_raw_nonzero().get();
    let list = proc_folder(own).join("task").join(own.to_string()).join("children");
    match fsx::read(&list) {
        Ok(list) => {
            String::from_utf8_lossy(&list).split_whitespace().filter_map(|pid| pid.parse().ok()).collect()
        }
        // The kernel was built without these lists.
        Err(_) => {
            all().into_iter().filter(|process| process.parent == own).map(|process| process.pid).collect()
        }
    }
}

#[cfg(test)]
#[cfg(target_os = "linux")]
mod tests {
    use super::*;

    #[test]
    fn a_stat_line_is_parsed_whatever_the_name_of_the_program() {
        let stat = b"42 (a) b) S 7 40 3 0 -1 4194560 1 2 3 4 5 6 7 8 20 0 1 0 98765 1000 10";
        let process = Process::parse(42, stat).unwrap();
        assert_eq!(process, Process { pid: 42, parent: 7, group: 40, began: 98765, is_zombie: false });
        assert_eq!(Process::parse(42, b"42 (half"), None);
    }

    #[test]
    fn a_process_belongs_to_the_folder_that_it_was_started_for() {
        let place = tempfile::tempdir().unwrap();
        let mut sleep = std::process::Command::new("sleep");
        let mut child = sleep.arg("60").env_clear().env("TMPDIR", place.path().join("work")).spawn().unwrap();
        let pid = i32::try_from(child.id()).unwrap();
        let belongs = || Process::of(pid).is_some_and(|process| process.belongs_to(place.path()));
        let began = std::time::Instant::now();
        while !belongs() {
            assert!(began.elapsed().as_secs() < 10);
        }
        assert!(!Process::of(pid).unwrap().belongs_to(Path::new("/else/where")));
        child.kill().unwrap();
        child.wait().unwrap();
        assert_eq!(Process::of(pid), None);
    }
}
