//! The warnings of a plan, on standard error: standard output is for what the command prints.

use super::terminal::{print_error, printable};
use crate::plan::Warning;
use crate::session::Loaded;

/// Prints the warnings about the selected stages, and returns them.
pub(super) fn show<'l>(loaded: &'l Loaded<'_>) -> &'l [Warning] {
    print(loaded.warnings());
    loaded.warnings()
}

/// Prints warnings.
pub(super) fn print(warnings: &[Warning]) {
    for Warning { message, hint } in warnings {
        print_error(&format!("warning: {}\n  = hint: {}\n", printable(message), printable(hint)));
    }
}
