//! How much memory a stage uses, and whether the system has killed processes because it ran out of memory. Both come from
//! `/proc`; on systems without it, memory limits are not enforced.

use std::collections::HashSet;
use std::path::Path;
use std::sync::Mutex;
use std::time::{Duration, Instant};

use rustix::process::Pid;

use super::processes;
use crate::fsx;

/// Resident memory in bytes of all processes of a group and all descendants of its leader; `None` where it is unknown.
pub(super) fn resident(group: Pid) -> Option<u64> {
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
    // A process that has ended since it was listed uses nothing.
    all.iter().any(|one| one.pid == group || one.group == group).then(|| {
        counted.iter().map(|pid| kept_by(&Path::new("/proc").join(pid.to_string())).unwrap_or_default()).sum()
    })
}

/// `VmRSS` in `/proc/<process>/status`, in bytes.
fn kept_by(process: &Path) -> Option<u64> {
    let status = fsx::read(&process.join("status")).ok()?;
    let status = String::from_utf8_lossy(&status);
    let line = status.lines().find_map(|line| line.strip_prefix("VmRSS:"))?;
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
        let bytes = resident(rustix::process::getpgrp()).unwrap();
        assert!((100_000..1 << 40).contains(&bytes), "{bytes}");
        assert!(resident(Pid::from_raw(i32::MAX).unwrap()).is_none());
    }
}
