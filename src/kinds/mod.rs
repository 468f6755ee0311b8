//! The stage kinds that come with the engine: any program as a stage, and what is brought in from outside. They serve
//! every experiment; what belongs to one field of work is a stage crate's.

mod command;
mod import;

use dril_stage_api::Kind;

/// The kinds.
pub const KINDS: [Kind; 2] = [Kind::of_program::<command::Command>(), Kind::of::<import::Import>()];
