//! What runs the learning stages, started by `dril-pipe`: the only executable that loads libtorch, which costs a quarter
//! of a second and 120 MB a process.

use std::process::ExitCode;

use dril_envs::gymnasium::{PythonHome, keep_python_in};
use dril_pipe::cli::{self, Extra};
use dril_stage_api::{Registry, RegistryError};

const SERVICES: [Extra; 1] = [Extra {
    name: "__replay",
    about: "a film of an episode",
    run: |args| dril_learn::play::replay::command(args).into(),
}];

fn main() -> Result<ExitCode, RegistryError> {
    let (folder, python) = cli::python_folders();
    keep_python_in(PythonHome { folder, python });
    Ok(cli::run_worker(&Registry::new(dril_learn::KINDS)?, &SERVICES, std::env::args_os()))
}
