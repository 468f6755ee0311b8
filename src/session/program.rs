//! Which build of this program runs: another build may parse, resolve or plan differently.

use crate::fsx;

/// Identifies this executable file; `None` where it cannot be found.
pub(super) fn identity() -> Option<String> {
    let path = std::env::current_exe().ok()?;
    fsx::identity(&path).ok()
}
