//! The command line: the only module that prints, reads the environment or exits.

use std::ffi::OsString;
use std::process::ExitCode;

use dril_stage_api::Registry;

/// A subcommand that a stage crate brings along.
#[derive(Clone, Copy, Debug)]
pub struct Extra {
    /// Its name on the command line.
    pub name: &'static str,
    /// One line for people.
    pub about: &'static str,
    /// Does the work with the arguments after the name; the text is printed, an error's text is reported.
    pub run: fn(&[OsString]) -> Result<String, String>,
}

/// Runs the program: `args` with the program's name first.
pub fn run(registry: Registry, args: impl IntoIterator<Item = OsString>) -> ExitCode {
    run_with(registry, &[], args)
}

/// As [`run`], with further subcommands.
pub fn run_with(registry: Registry, extras: &[Extra], args: impl IntoIterator<Item = OsString>) -> ExitCode {
    let _ = (registry, extras, args.into_iter().count());
    ExitCode::FAILURE
}
