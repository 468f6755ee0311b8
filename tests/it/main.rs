//! All tests that run the engine from the outside, in one binary. Lower-level tests stand beside the code.
#![allow(
    clippy::unwrap_used,
    clippy::expect_used,
    clippy::panic,
    clippy::print_stdout,
    clippy::print_stderr,
    reason = "clippy takes only functions marked as tests for tests, and not what they share"
)]

mod ages;
mod bad;
mod cache;
mod care;
mod circles;
mod cli;
mod cli_texts;
mod command;
mod crash;
mod doctor;
mod editors;
mod ends;
mod examples;
mod exec_order;
mod executors;
mod fakes;
mod fresh;
mod group;
mod hostile;
mod import;
mod inspect;
mod lab;
mod language;
mod limits;
mod machines;
mod nodes;
mod page;
mod parse;
mod places;
mod plan;
mod programs;
mod prop;
#[cfg(feature = "remote")]
mod remote;
#[cfg(feature = "remote")]
mod remote_net;
mod resolve;
mod results;
mod rough;
mod samples;
mod scenario;
mod sealed;
mod size;
mod slurm;
mod stops;
mod survivors;
#[cfg(feature = "stages")]
mod thesis;
mod tidy;
mod tools;
mod unchanged;
mod untrusted;
mod warnings;
mod watch;
