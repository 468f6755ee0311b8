//! The worker executable that runs the learning stages, started by `dril-pipe`: the only executable that loads libtorch,
//! which costs a quarter of a second and 120 MB per process.

use std::process::ExitCode;

use dril_envs::gymnasium::{PythonHome, keep_python_in};
use dril_pipe::cli::{self, ExtraCommand};
use dril_stage_api::{Registry, RegistryError};

const SERVICES: [ExtraCommand; 1] = [ExtraCommand {
    name: dril_kinds::REPLAY.service,
    about: dril_kinds::REPLAY.about,
    run: |args| dril_learn::play::replay::command(args).into(),
}];

fn main() -> Result<ExitCode, RegistryError> {
    keep_python_in(PythonHome::from_environment());
    Ok(cli::run_worker(&Registry::new(dril_learn::KINDS)?, &SERVICES, std::env::args_os()))
}
