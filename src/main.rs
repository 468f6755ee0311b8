//! The program: hands the stage kinds that it offers to the command line. Nothing else belongs here.

use dril_pipe::{cli, kinds};
use dril_stage_api::{Kind, Registry, RegistryError};
use std::process::ExitCode;

/// To plan thousands of stages is to make and drop a hundred thousand small values.
#[global_allocator]
static ALLOCATOR: mimalloc::MiMalloc = mimalloc::MiMalloc;

#[cfg(feature = "stages")]
const EXTRAS: &[cli::Extra] = &[cli::Extra {
    name: "env",
    about: dril_envs::command::ABOUT,
    run: |args| {
        let (folder, python) = cli::python_folders();
        dril_envs::gymnasium::keep_python_in(dril_envs::gymnasium::PythonHome { folder, python });
        dril_envs::command::run(args)
    },
}];
#[cfg(not(feature = "stages"))]
const EXTRAS: &[cli::Extra] = &[];

fn main() -> Result<ExitCode, RegistryError> {
    #[cfg(feature = "stages")]
    let kinds: Vec<Kind> =
        [&kinds::KINDS[..], &dril_kinds::KINDS, &dril_envs::KINDS, &dril_report::KINDS].concat();
    #[cfg(feature = "stages")]
    cli::keep_page(dril_report::html::page, dril_report::html::MARK);
    #[cfg(not(feature = "stages"))]
    let kinds: Vec<Kind> = kinds::KINDS.to_vec();
    Ok(cli::run_with(Registry::new(kinds)?, EXTRAS, std::env::args_os()))
}
