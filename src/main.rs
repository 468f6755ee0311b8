//! The program: passes stage kinds, artifact types and subcommands to the command line. Nothing else belongs here.

use dril_pipe::cli::{self, Extensions};
use dril_pipe::kinds;
use dril_stage_api::Registry;
use std::process::ExitCode;

/// Planning thousands of stages allocates a hundred thousand small values.
#[global_allocator]
static ALLOCATOR: mimalloc::MiMalloc = mimalloc::MiMalloc;

#[cfg(feature = "stages")]
fn main() -> Result<ExitCode, Box<dyn std::error::Error>> {
    use dril_envs::gymnasium::{PythonHome, keep_python_in};
    let env = cli::ExtraCommand {
        name: "env",
        about: dril_parity::command::ABOUT,
        run: |args| {
            keep_python_in(PythonHome::from_environment());
            dril_parity::command::run(args)
        },
    };
    let extensions = Extensions { commands: &[env], tools: &[dril_kinds::REPLAY] };
    let kinds = [&kinds::KINDS[..], &dril_kinds::KINDS, &dril_envs::KINDS, &dril_report::KINDS].concat();
    dril_stage_api::artifact::register(&dril_kinds::artifacts::ARTIFACTS)?;
    cli::keep_page(dril_report::html::page, dril_report::html::MARK);
    Ok(cli::run_with(Registry::new(kinds)?, extensions, std::env::args_os()))
}

#[cfg(not(feature = "stages"))]
fn main() -> Result<ExitCode, Box<dyn std::error::Error>> {
    Ok(cli::run_with(Registry::new(kinds::KINDS)?, Extensions::default(), std::env::args_os()))
}
