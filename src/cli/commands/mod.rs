//! The subcommands, one file or folder each.

pub(super) mod cache;
mod forecast;
pub(super) mod graph;
pub(super) mod inspect;
pub(super) mod kinds;
pub(super) mod page;
pub(super) mod plan;
mod recheck;
pub(super) mod run;
pub(super) mod shell;
pub(super) mod tool;
pub(super) mod watch;
