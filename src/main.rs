//! The program: hands the stage kinds that it offers to the command line. Nothing else belongs here.

use std::process::ExitCode;

use dril_pipe::{cli, kinds};
use dril_stage_api::{Kind, Registry, RegistryError};

fn main() -> Result<ExitCode, RegistryError> {
    #[cfg(feature = "stages")]
    let kinds: Vec<Kind> = [&kinds::KINDS[..], &dril_kinds::KINDS, &dril_report::KINDS].concat();
    #[cfg(not(feature = "stages"))]
    let kinds: Vec<Kind> = kinds::KINDS.to_vec();
    Ok(cli::run(Registry::new(kinds)?, std::env::args_os()))
}
