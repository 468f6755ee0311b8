//! How much memory a process group keeps, and whether the system has killed for want of memory. From `/proc`: where that
//! is not there, nothing is known, and no limit is enforced.

use std::path::{Path, PathBuf};
use std::sync::Mutex;
use std::time::{Duration, Instant};

use rustix::process::Pid;

use crate::fsx;

/// Bytes of memory that the processes of a group keep; `None` where that cannot be known.
pub(super) fn resident(group: Pid) -> Option<u64> {
    let processes = fsx::list(Path::new("/proc")).ok()?;
    let is_number = |path: &&PathBuf| {
        path.file_name().is_some_and(|name| name.as_encoded_bytes().iter().all(u8::is_ascii_digit))
    };
    let mut bytes = None;
    for process in processes.iter().filter(is_number) {
        if group_of(process) == Some(group.as_raw_nonzero().get()) {
            // One that has ended since it was listed keeps nothing.
            *bytes.get_or_insert(0) += kept_by(process).unwrap_or_default();
        }
    }
    bytes
}

/// The process group of a process, given by its folder in `/proc`.
pub(super) fn group_of(process: &Path) -> Option<i32> {
    field(process, 2)
}

/// The process that started it, or took it over when that one died.
pub(super) fn parent_of(process: &Path) -> Option<i32> {
    field(process, 1)
}

/// A number of `/proc/<process>/stat`, counted from the first field after the name, which ends at the last `)`.
fn field(process: &Path, number: usize) -> Option<i32> {
    let stat = fsx::read(&process.join("stat")).ok()?;
    let stat = String::from_utf8_lossy(&stat);
    stat.rsplit_once(')')?.1.split_whitespace().nth(number)?.parse().ok()
}

/// `VmRSS` in `/proc/<process>/status`, in bytes.
fn kept_by(process: &Path) -> Option<u64> {
    let status = fsx::read(&process.join("status")).ok()?;
    let status = String::from_utf8_lossy(&status);
    let line = status.lines().find_map(|line| line.strip_prefix("VmRSS:"))?;
    line.split_whitespace().next()?.parse::<u64>().ok().map(|kibibytes| kibibytes * 1024)
}

/// How often the system has killed a process because memory ran out, since it was started.
pub(super) fn kills() -> Option<u64> {
    let counters = fsx::read(Path::new("/proc/vmstat")).ok()?;
    let counters = String::from_utf8_lossy(&counters);
    counters.lines().find_map(|line| line.strip_prefix("oom_kill "))?.trim().parse().ok()
}

/// As [`kills`], and at most a second old: to have the system count all that it counts takes as long as making a folder,
/// and stages may be short.
pub(super) fn kills_lately() -> Option<u64> {
    static LAST: Mutex<Option<(Instant, Option<u64>)>> = Mutex::new(None);
    let mut last = LAST.lock().ok()?;
    match *last {
        Some((when, kills)) if when.elapsed() < Duration::from_secs(1) => kills,
        _ => {
            let kills = kills();
            *last = Some((Instant::now(), kills));
            kills
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    #[cfg(target_os = "linux")]
    fn a_group_keeps_the_memory_of_its_processes() {
        let bytes = resident(rustix::process::getpgrp()).unwrap();
        assert!((100_000..1 << 40).contains(&bytes), "{bytes}");
        assert!(resident(Pid::from_raw(i32::MAX).unwrap()).is_none());
    }
}
