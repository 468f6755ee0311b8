//! The program: hands the stage kinds that it offers to the command line. Nothing else belongs here.

use std::process::ExitCode;

use dril_pipe::cli;
use dril_stage_api::{Registry, RegistryError};

fn main() -> Result<ExitCode, RegistryError> {
    Ok(cli::run(Registry::new([])?, std::env::args_os()))
}
