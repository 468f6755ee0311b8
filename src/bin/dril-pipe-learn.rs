//! What runs the learning stages, started by `dril-pipe`: the only executable that loads libtorch, which costs a quarter
//! of a second and 120 MB a process.

use std::process::ExitCode;

use dril_pipe::cli;
use dril_stage_api::{Registry, RegistryError};

fn main() -> Result<ExitCode, RegistryError> {
    Ok(cli::run_worker(&Registry::new(dril_learn::KINDS)?, std::env::args_os()))
}
