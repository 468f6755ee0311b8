//! Signals: the first SIGINT or SIGTERM asks the run to stop, the second one ends the program immediately. SIGHUP (a closed
//! terminal or connection) asks the run to stop, however often it comes: terminals send it more than once.

use std::path::Path;
use std::sync::atomic::AtomicBool;
use std::sync::{Arc, OnceLock};

use signal_hook::consts::{SIGHUP, SIGINT, SIGTERM};
use signal_hook::flag;

use crate::error::{Error, ErrorKind, exit_codes};
use crate::fsx;

/// One flag per process: `watch` runs a pipeline many times.
static STOP: OnceLock<Arc<AtomicBool>> = OnceLock::new();

/// A flag that the first signal sets. A second signal ends the program immediately; running stages die with it, and the store
/// is consistent at any moment.
///
/// # Errors
/// The signal handlers cannot be installed.
pub(super) fn stop_flag() -> Result<Arc<AtomicBool>, Error> {
    if let Some(stop) = STOP.get() {
        return Ok(Arc::clone(stop));
    }
    let stop = Arc::new(AtomicBool::new(false));
    let failed = |error| Error::new(ErrorKind::Io, format!("cannot install signal handlers: {error}"));
    for signal in [SIGINT, SIGTERM] {
        // In this order: the shutdown handler checks the flag before this signal sets it.
        let code = i32::from(exit_codes::INTERRUPTED);
        flag::register_conditional_shutdown(signal, code, Arc::clone(&stop))
            .and_then(|_| flag::register(signal, Arc::clone(&stop)))
            .map_err(failed)?;
    }
    // Under `nohup` the run continues.
    if !hangup_is_ignored() {
        flag::register(SIGHUP, Arc::clone(&stop)).map_err(failed)?;
    }
    Ok(Arc::clone(STOP.get_or_init(|| stop)))
}

/// True where this process was started with SIGHUP ignored.
fn hangup_is_ignored() -> bool {
    let status = fsx::read(Path::new("/proc/self/status")).unwrap_or_default();
    let status = String::from_utf8_lossy(&status);
    let ignored = status.lines().find_map(|line| line.strip_prefix("SigIgn:"));
    let mask = ignored.and_then(|mask| u64::from_str_radix(mask.trim(), 16).ok());
    mask.is_some_and(|mask| mask & (1 << (SIGHUP - 1)) != 0)
}
