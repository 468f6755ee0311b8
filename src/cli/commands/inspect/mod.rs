//! The read-only commands: they inspect the store and its runs.

pub(in crate::cli) mod diff;
pub(in crate::cli) mod explain;
pub(in crate::cli) mod failures;
mod ids;
pub(in crate::cli) mod log;
mod logs;
mod overview;
mod pair;
mod pick;
mod renamed;
pub(in crate::cli) mod runs;
pub(in crate::cli) mod show;
pub(in crate::cli) mod status;

use std::time::{Duration, SystemTime};

use crate::cli::terminal::duration;

pub(super) use pick::{pick_run, pick_stages};

/// The age of a time: `3 h 12 min ago`. A time in the future is `0 s ago`.
pub(super) fn age(time: SystemTime) -> String {
    let seconds = SystemTime::now().duration_since(time).unwrap_or_default().as_secs();
    if seconds < 60 {
        format!("{seconds} s ago")
    } else {
        format!("{} ago", duration(Duration::from_secs(seconds)))
    }
}

/// Seconds since 1970, for JSON.
pub(super) fn epoch(time: SystemTime) -> f64 {
    time.duration_since(SystemTime::UNIX_EPOCH).unwrap_or_default().as_millis() as f64 / 1000.0
}

/// A duration for people, from seconds.
fn seconds(seconds: f64) -> String {
    duration(Duration::try_from_secs_f64(seconds).unwrap_or_default())
}

/// A size for people: `312 B`, `4.2 KiB`, `1.9 GiB`.
pub(in crate::cli) fn size(bytes: u64) -> String {
    const UNITS: [&str; 5] = ["KiB", "MiB", "GiB", "TiB", "PiB"];
    if bytes < 1024 {
        return format!("{bytes} B");
    }
    let mut value = bytes as f64 / 1024.0;
    let mut unit = 0;
    while value >= 1023.95 && unit + 1 < UNITS.len() {
        value /= 1024.0;
        unit += 1;
    }
    format!("{value:.1} {}", UNITS[unit])
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn sizes_have_a_unit_that_fits() {
        let texts = [0, 1023, 1024, 1_048_575, 5 << 30].map(size);
        assert_eq!(texts, ["0 B", "1023 B", "1.0 KiB", "1.0 MiB", "5.0 GiB"]);
    }

    #[test]
    fn a_time_in_the_future_is_as_old_as_now() {
        assert_eq!(age(SystemTime::now() + Duration::from_secs(1000)), "0 s ago");
    }
}
