//! From a pipeline file on the command line to its graph: what `run`, `plan` and `graph` begin with.

use std::collections::BTreeMap;
use std::ffi::OsString;
use std::path::{Path, PathBuf};

use dril_stage_api::Registry;

use super::args::{PipelineArgs, StoreArgs};
use crate::error::Error;
use crate::fsx;
use crate::resolve::{self, Choices, Graph};
use crate::spec::{self, Diagnostics, SourceName};
use crate::store::Store;

/// The environment variable that names the store.
const CACHE: &str = "DRIL_PIPE_CACHE";

/// Reads and resolves the pipeline file.
///
/// # Errors
/// All that is wrong with it.
pub(super) fn load(args: &PipelineArgs, registry: &Registry) -> Result<Graph, Error> {
    let name = SourceName(args.file.display().to_string());
    let bytes = fsx::read(&args.file).map_err(|error| Diagnostics::unreadable(&name, &error.source))?;
    let spec = spec::parse_bytes(&bytes, &name)?;
    let choices = Choices { environment: environment(), ..args.choices() };
    Ok(resolve::resolve(&spec, &choices, registry)?)
}

/// The variables whose names and values are text.
fn environment() -> BTreeMap<String, String> {
    let all = std::env::vars_os();
    all.filter_map(|(name, value)| Some((name.into_string().ok()?, value.into_string().ok()?))).collect()
}

/// Reads a pipeline file and resolves it with each of its profiles.
///
/// # Errors
/// All that is wrong with it.
pub(super) fn load_all_profiles(file: &Path, registry: &Registry) -> Result<Vec<Graph>, Error> {
    let name = SourceName(file.display().to_string());
    let bytes = fsx::read(file).map_err(|error| Diagnostics::unreadable(&name, &error.source))?;
    let spec = spec::parse_bytes(&bytes, &name)?;
    let mut profiles: Vec<Option<String>> = spec.profiles().map(|profile| Some(profile.to_owned())).collect();
    if profiles.is_empty() {
        profiles.push(None);
    }
    let mut graphs = Vec::new();
    for profile in profiles {
        let choices = Choices { profile, environment: environment(), ..Choices::default() };
        graphs.push(resolve::resolve(&spec, &choices, registry)?);
    }
    Ok(graphs)
}

/// The folder that the pipeline file's paths are relative to.
pub(super) fn base(args: &PipelineArgs) -> PathBuf {
    base_of(&args.file)
}

/// The folder that the paths of this pipeline file are relative to.
pub(super) fn base_of(file: &Path) -> PathBuf {
    match file.parent() {
        Some(folder) if !folder.as_os_str().is_empty() => folder.to_owned(),
        _ => PathBuf::from("."),
    }
}

/// Opens the store that the arguments or the environment name.
///
/// # Errors
/// It cannot be used.
pub(super) fn store(args: &StoreArgs) -> Result<Store, Error> {
    let env: Option<OsString> = std::env::var_os(CACHE);
    let folder = args.folder(env);
    Ok(Store::open(Path::new(&folder))?)
}
