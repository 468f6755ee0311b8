//! SIGINT and SIGTERM: the first asks the run to stop, the second ends the program at once.

use std::sync::atomic::AtomicBool;
use std::sync::{Arc, OnceLock};

use signal_hook::consts::{SIGINT, SIGTERM};
use signal_hook::flag;

use crate::error::{Error, ErrorKind, exit_codes};

/// One for the program: `watch` runs a pipeline many times.
static STOP: OnceLock<Arc<AtomicBool>> = OnceLock::new();

/// A flag that the first signal raises. After that, another signal ends the program where it stands; the stages that run
/// die with it, and the store is whole at any moment.
///
/// # Errors
/// The system refuses.
pub(super) fn stop_flag() -> Result<Arc<AtomicBool>, Error> {
    if let Some(stop) = STOP.get() {
        return Ok(Arc::clone(stop));
    }
    let stop = Arc::new(AtomicBool::new(false));
    for signal in [SIGINT, SIGTERM] {
        // In this order: the shutdown looks at the flag before this signal raises it.
        let code = i32::from(exit_codes::INTERRUPTED);
        flag::register_conditional_shutdown(signal, code, Arc::clone(&stop))
            .and_then(|_| flag::register(signal, Arc::clone(&stop)))
            .map_err(|error| Error::new(ErrorKind::Io, format!("cannot listen to signals: {error}")))?;
    }
    Ok(Arc::clone(STOP.get_or_init(|| stop)))
}
