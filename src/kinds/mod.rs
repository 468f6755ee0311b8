//! The built-in stage kinds: `command` runs any program, `import` brings in files from outside. Kinds of a particular field belong
//! to stage crates.

mod command;
mod import;

use dril_stage_api::Kind;

/// The kinds.
pub const KINDS: [Kind; 2] = [Kind::of_program::<command::Command>(), Kind::of::<import::Import>()];
