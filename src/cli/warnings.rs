//! The warnings of a plan, on standard error: standard output is for what the command prints.

use super::terminal::{print_error, printable};
use crate::plan::{Warning, warnings};
use crate::session::Loaded;

/// Prints the warnings about the selected stages, and returns them.
pub(super) fn show(loaded: &Loaded<'_>) -> Vec<Warning> {
    let found = warnings(loaded.whole_graph(), loaded.graph(), &loaded.base());
    for Warning { message, hint } in &found {
        print_error(&format!("warning: {}\n  = hint: {}\n", printable(message), printable(hint)));
    }
    found
}
