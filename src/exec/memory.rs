//! How much memory a stage uses, and whether the system has killed processes because it ran out of memory. Both come from
//! `/proc`; on systems without it, memory limits are not enforced.

use std::collections::HashSet;
use std::path::{Path, PathBuf};
use std::sync::Mutex;
use std::time::{Duration, Instant};

use rustix::process::Pid;

use super::processes;
use crate::fsx;

/// The memory in bytes of all processes of a group and all descendants of its leader, where it is above a limit.
pub(super) fn used_above(group: Pid, limit: u64) -> Option<u64> {
    let processes = processes_of(group);
    let sum = |used: &dyn Fn(&Path) -> Option<u64>| -> u64 {
        // A process that has ended since it was listed uses nothing.
        processes.iter().map(|process| used(process).unwrap_or_default()).sum()
    };
    // Quick to find out, but it counts what processes share, as after a fork, once for each of them.
    let resident = sum(&resident);
    if resident <= limit {
        return None;
    }
    Some(sum(&|process| share(process).or_else(|| self::resident(process)))).filter(|bytes| *bytes > limit)
}

/// The folders in `/proc` of all processes of a group and all descendants of its leader.
fn processes_of(group: Pid) -> Vec<PathBuf> {
    let all = processes::all();
    let group = group.as_raw_nonzero().get();
    let mut counted: HashSet<i32> =
        all.iter().filter(|one| one.group == group).map(|one| one.pid).chain([group]).collect();
    // A child may be listed before its parent.
    loop {
        let before = counted.len();
        counted.extend(
            all.iter().filter(|one| counted.contains(&one.parent)).map(|one| one.pid).collect::<Vec<_>>(),
        );
        if counted.len() == before {
            break;
        }
    }
    counted.iter().map(|pid| Path::new("/proc").join(pid.to_string())).collect()
}

/// The resident memory of a process, in bytes.
fn resident(process: &Path) -> Option<u64> {
    field(&process.join("status"), "VmRSS:")
}

/// The same, but of memory that several processes share only this one's part; `None` where the system does not tell (before Linux
/// 4.14, and of processes of other users).
fn share(process: &Path) -> Option<u64> {
    field(&process.join("smaps_rollup"), "Pss:")
}

/// A line of a file in `/proc`, in bytes.
fn field(file: &Path, name: &str) -> Option<u64> {
    let text = fsx::read(file).ok()?;
    let text = String::from_utf8_lossy(&text);
    let line = text.lines().find_map(|line| line.strip_prefix(name))?;
    line.split_whitespace().next()?.parse::<u64>().ok().map(|kibibytes| kibibytes * 1024)
}

/// How many processes the system has killed since boot because it ran out of memory.
pub(super) fn kills() -> Option<u64> {
    let counters = fsx::read(Path::new("/proc/vmstat")).ok()?;
    let counters = String::from_utf8_lossy(&counters);
    counters.lines().find_map(|line| line.strip_prefix("oom_kill "))?.trim().parse().ok()
}

/// As [`kills`], cached for a second: reading all counters takes as long as creating a folder, and stages may be short.
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
    fn the_memory_of_a_stage_is_that_of_its_processes() {
        let bytes = used_above(rustix::process::getpgrp(), 100_000).unwrap();
        assert!((100_000..1 << 40).contains(&bytes), "{bytes}");
        assert!(used_above(rustix::process::getpgrp(), 1 << 40).is_none());
        assert!(used_above(Pid::from_raw(i32::MAX).unwrap(), 0).is_none());
        let own = Path::new("/proc/self");
        assert!(share(own).unwrap() <= resident(own).unwrap());
    }
}
