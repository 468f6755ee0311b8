//! The clock of a file system: the time that its server gives to a file that changes now. The clocks of two machines may differ
//! by minutes, so ages of files are never measured with the local one.

use std::path::{Path, PathBuf};
use std::sync::{Mutex, PoisonError};
use std::time::{Duration, Instant, SystemTime};

/// How long one reading is extrapolated. Clocks drift by much less than a second in this time.
const VALID: Duration = Duration::from_secs(5);

/// The last reading: folder, when it was taken, and what it was.
static LAST: Mutex<Option<(PathBuf, Instant, SystemTime)>> = Mutex::new(None);

/// The time on the file system of `folder`: that of a file that is created there now. The local time where nothing can be
/// created.
pub(super) fn now(folder: &Path) -> SystemTime {
    let mut last = LAST.lock().unwrap_or_else(PoisonError::into_inner);
    if let Some((of, read, time)) = last.as_ref()
        && of == folder
        && read.elapsed() < VALID
    {
        return *time + read.elapsed();
    }
    let read = Instant::now();
    match probe(folder) {
        Ok(time) => {
            *last = Some((folder.to_owned(), read, time));
            time
        }
        Err(_) => SystemTime::now(),
    }
}

fn probe(folder: &Path) -> std::io::Result<SystemTime> {
    // It has no name where the file system allows that, so a process that dies here leaves nothing behind.
    tempfile::tempfile_in(folder)?.metadata()?.modified()
}

/// The time since boot in milliseconds. It advances while the machine is suspended.
pub(super) fn since_boot() -> u64 {
    #[cfg(target_os = "linux")]
    const CLOCK: rustix::time::ClockId = rustix::time::ClockId::Boottime;
    #[cfg(not(target_os = "linux"))]
    const CLOCK: rustix::time::ClockId = rustix::time::ClockId::Monotonic;
    let time = rustix::time::clock_gettime(CLOCK);
    u64::try_from(time.tv_sec).unwrap_or(0) * 1000 + u64::try_from(time.tv_nsec).unwrap_or(0) / 1_000_000
}
