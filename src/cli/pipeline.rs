//! From arguments and environment to a session: the pipeline file with the choices made for it, and the store.

use std::ffi::OsString;
use std::path::Path;

use dril_stage_api::Registry;

use super::args::{PipelineArgs, StoreArgs};
use crate::error::Error;
use crate::resolve::Choices;
use crate::session::{PipelineSource, Session};
use crate::store::Store;

/// The environment variable that names the store.
const CACHE: &str = "DRIL_PIPE_CACHE";

/// The pipeline and the store that the arguments name.
///
/// # Errors
/// The store's path is not a folder.
pub(super) fn session<'r>(
    pipeline: &PipelineArgs,
    store: &StoreArgs,
    registry: &'r Registry,
) -> Result<Session<'r>, Error> {
    Ok(Session::with(source(pipeline), self::store(store)?, registry))
}

/// The pipeline file that the arguments name, with their choices and the variables of this process.
pub(super) fn source(args: &PipelineArgs) -> PipelineSource {
    PipelineSource::new(&args.file, with_environment(args.choices()))
}

/// A pipeline file without choices, with the variables of this process.
pub(super) fn source_of(file: &Path) -> PipelineSource {
    PipelineSource::new(file, with_environment(Choices::default()))
}

/// Adds the variables of this process: values that are text, and the names of those that are not.
fn with_environment(mut choices: Choices) -> Choices {
    for (name, value) in std::env::vars_os() {
        match (name.into_string(), value.into_string()) {
            (Ok(name), Ok(value)) => drop(choices.environment.insert(name, value)),
            (Ok(name), Err(_)) => drop(choices.not_text.insert(name)),
            (Err(_), _) => {}
        }
    }
    choices
}

/// Opens the store that the arguments or the environment name.
///
/// # Errors
/// Its path is not a folder.
pub(super) fn store(args: &StoreArgs) -> Result<Store, Error> {
    let env: Option<OsString> = std::env::var_os(CACHE);
    Ok(Store::open(&args.folder(env))?)
}
