//! From a pipeline file on the command line to its graph: what `run`, `plan` and `graph` begin with.

use std::collections::BTreeMap;
use std::ffi::OsString;
use std::path::{Path, PathBuf};

use dril_stage_api::Registry;

use super::args::{PipelineArgs, SelectArgs, StoreArgs};
use super::inspect::no_stage;
use crate::error::{Error, ErrorKind};
use crate::fsx;
use crate::plan::{self, Plan, Verdict};
use crate::resolve::{self, Choices, Graph, Selected};
use crate::spec::{self, Diagnostics, Memo, SourceName, Spec};
use crate::store::{Digest, Store};

/// The environment variable that names the store.
const CACHE: &str = "DRIL_PIPE_CACHE";

/// Files of fewer bytes are read faster than what is known of them.
const SMALL: usize = 16 << 10;

/// Reads and resolves the pipeline file.
///
/// # Errors
/// All that is wrong with it.
pub(super) fn load(args: &PipelineArgs, registry: &Registry) -> Result<Graph, Error> {
    load_with(args, registry, &mut Reading::default())
}

/// What reading a pipeline file learns beside its graph.
#[derive(Default)]
pub(super) struct Reading<'s> {
    /// Files that it includes, directly or through others, with the content that was read.
    pub parts: BTreeMap<PathBuf, Digest>,
    /// Where to look for what is known of the file.
    store: Option<&'s Store>,
    memo: Option<(Digest, Memo)>,
}

impl<'s> Reading<'s> {
    /// With what the store knows of the file.
    pub fn from(store: &'s Store) -> Self {
        Self { store: Some(store), ..Self::default() }
    }

    /// Keeps what was read for the next time. That this does not work is no error.
    pub fn keep(&self) {
        if let (Some(store), Some((name, memo))) = (self.store, &self.memo)
            && let Some(bytes) = memo.bytes()
        {
            let _ = store.keep_parsed(name, &bytes);
        }
    }

    fn parse(&mut self, file: &Path, bytes: &[u8], name: &SourceName) -> Result<Spec, Diagnostics> {
        let base = base_of(file);
        let parts = &mut self.parts;
        let mut load = |path: &str| {
            let path = base.join(path);
            let bytes = fsx::read(&path).map_err(|error| error.source)?;
            parts.insert(path, Digest::of(&bytes));
            Ok(bytes)
        };
        if let Some(store) = self.store
            && bytes.len() >= SMALL
            && let (Ok(path), Some(program)) = (std::path::absolute(file), super::unchanged::program())
        {
            // Another build may read a text as something else.
            let name = [path.as_os_str().as_encoded_bytes(), b"\0", program.as_bytes()].concat();
            let name = Digest::of(&name);
            self.memo = Some((name, Memo::read(store.parsed(&name))));
        }
        match &mut self.memo {
            Some((_, memo)) => spec::parse_remembering(bytes, name, &mut load, memo),
            None => spec::parse_with(bytes, name, &mut load),
        }
    }
}

pub(super) fn load_with(
    args: &PipelineArgs,
    registry: &Registry,
    reading: &mut Reading<'_>,
) -> Result<Graph, Error> {
    let name = SourceName(args.file.display().to_string());
    let spec = read(&args.file, &name, reading)?;
    let choices = environment(args.choices());
    Ok(resolve::resolve(&spec, &choices, registry)?)
}

/// Reads a pipeline file and those that it includes.
fn read(file: &Path, name: &SourceName, reading: &mut Reading<'_>) -> Result<Spec, Error> {
    let bytes = fsx::read(file).map_err(|error| Diagnostics::unreadable(name, &error.source))?;
    Ok(reading.parse(file, &bytes, name)?)
}

/// The choices with the variables of this process: those that are text, and the names of those that are not.
fn environment(mut choices: Choices) -> Choices {
    for (name, value) in std::env::vars_os() {
        match (name.into_string(), value.into_string()) {
            (Ok(name), Ok(value)) => drop(choices.environment.insert(name, value)),
            (Ok(name), Err(_)) => drop(choices.not_text.insert(name)),
            (Err(_), _) => {}
        }
    }
    choices
}

/// The profile that is used when none is named, where the file has profiles.
///
/// # Errors
/// All that is wrong with the file.
pub(super) fn first_profile(args: &PipelineArgs) -> Result<Option<String>, Error> {
    let name = SourceName(args.file.display().to_string());
    let spec = read(&args.file, &name, &mut Reading::default())?;
    Ok(spec.profiles().next().map(str::to_owned))
}

/// Reads a pipeline file and resolves it with each of its profiles.
///
/// # Errors
/// All that is wrong with it.
pub(super) fn load_all_profiles(file: &Path, registry: &Registry) -> Result<Vec<Graph>, Error> {
    let name = SourceName(file.display().to_string());
    let spec = read(file, &name, &mut Reading::default())?;
    let mut profiles: Vec<Option<String>> = spec.profiles().map(|profile| Some(profile.to_owned())).collect();
    if profiles.is_empty() {
        profiles.push(None);
    }
    let mut graphs = Vec::new();
    for profile in profiles {
        let choices = environment(Choices { profile, ..Choices::default() });
        graphs.push(resolve::resolve(&spec, &choices, registry)?);
    }
    Ok(graphs)
}

/// As [`load`], and the part of the graph that is asked for; `reading` is told what else was learned.
///
/// # Errors
/// All that is wrong with the file, or the first pattern that means no stage.
pub(super) fn select(
    args: &PipelineArgs,
    select: &SelectArgs,
    registry: &Registry,
    reading: &mut Reading<'_>,
) -> Result<Selected, Error> {
    let graph = load_with(args, registry, reading)?;
    select.selection().of(graph).map_err(no_stage)
}

/// The plan for what is selected.
///
/// # Errors
/// No plan can be made, or stages that were not asked for would have to run.
pub(super) fn plan<'g>(
    selected: &'g Selected,
    store: &Store,
    args: &PipelineArgs,
) -> Result<Plan<'g>, Error> {
    let Selected { graph, settled, forced, .. } = selected;
    let plan = plan::plan_forced(graph, store, &base(args), forced.clone())?;
    let stale = plan
        .steps
        .iter()
        .filter(|(stage, verdict)| settled.contains(stage) && !matches!(verdict, Verdict::Cached { .. }));
    let stale: Vec<String> = stale.map(|(stage, _)| format!("`{}`", graph.stages[*stage].id)).collect();
    if let Some(first) = stale.first() {
        let more = if stale.len() > 1 { format!(" and {} more", stale.len() - 1) } else { String::new() };
        let message = format!("`--only` leaves out {first}{more}, which is needed and not cached");
        return Err(Error::new(ErrorKind::Usage, message).hint("leave `--only` out, and it runs too"));
    }
    Ok(plan)
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
