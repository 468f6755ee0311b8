//! From a pipeline file to its graph: reads the file and those that it includes, and resolves them.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

use dril_stage_api::Registry;

use super::program;
use crate::error::{Error, ErrorKind};
use crate::fsx;
use crate::plan::{self, Plan, Verdict};
use crate::resolve::{self, Choices, Graph, Selected, Selection};
use crate::spec::{self, Diagnostics, Memo, SourceName, Spec};
use crate::store::{Digest, Store};

/// Files with fewer bytes are parsed faster than their memo is read.
const SMALL: usize = 16 << 10;

/// A pipeline file, and the choices made for it: profile, overrides, environment.
#[derive(Clone, Debug)]
pub struct PipelineSource {
    /// The pipeline file.
    pub file: PathBuf,
    /// Profile, overrides and environment variables.
    pub choices: Choices,
}

/// The texts of a pipeline file and of those that it includes.
#[derive(Default)]
pub(super) struct Texts {
    pub main: Vec<u8>,
    pub parts: BTreeMap<String, Vec<u8>>,
}

/// What reading a pipeline file yields beside its graph.
#[derive(Default)]
pub struct Reading<'s> {
    /// The files that it includes, directly or through others, with the digest of what was read.
    pub parts: BTreeMap<PathBuf, Digest>,
    /// What was read: the file itself, and by their paths from its folder those that it includes.
    pub(super) texts: Texts,
    /// Where memos of parsed files are kept.
    store: Option<&'s Store>,
    memo: Option<(Digest, Memo)>,
}

impl<'s> Reading<'s> {
    /// With the memos of a store, so that an unchanged part of a large file is not parsed again.
    pub fn with_memo(store: &'s Store) -> Self {
        Self { store: Some(store), ..Self::default() }
    }

    /// Stores the memo for the next time. Failing to do so is not an error.
    pub fn keep(&self) {
        if let (Some(store), Some((name, memo))) = (self.store, &self.memo)
            && let Some(bytes) = memo.bytes()
        {
            let _ = store.keep_parsed(name, &bytes);
        }
    }

    fn parse(&mut self, file: &Path, bytes: &[u8], name: &SourceName) -> Result<Spec, Diagnostics> {
        let base = base_of(file);
        let (parts, texts) = (&mut self.parts, &mut self.texts);
        texts.main = bytes.to_vec();
        let mut load = |name: &str| {
            let path = base.join(name);
            let bytes = fsx::read(&path).map_err(|error| error.source)?;
            parts.insert(path, Digest::of(&bytes));
            texts.parts.insert(name.to_owned(), bytes.clone());
            Ok(bytes)
        };
        if let Some(store) = self.store
            && bytes.len() >= SMALL
            && let (Ok(path), Some(program)) = (std::path::absolute(file), program::identity())
        {
            // Another build may parse a text differently.
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

impl PipelineSource {
    /// A pipeline file with these choices.
    pub fn new(file: impl Into<PathBuf>, choices: Choices) -> Self {
        Self { file: file.into(), choices }
    }

    /// Reads and resolves the file.
    ///
    /// # Errors
    /// All problems of the file and of the choices, each with its place.
    pub fn load(&self, registry: &Registry) -> Result<Graph, Error> {
        self.load_with(registry, &mut Reading::default())
    }

    /// As [`PipelineSource::load`]; `reading` receives what else was learned.
    ///
    /// # Errors
    /// As [`PipelineSource::load`].
    pub fn load_with(&self, registry: &Registry, reading: &mut Reading<'_>) -> Result<Graph, Error> {
        let spec = read(&self.file, reading)?;
        Ok(resolve::resolve(&spec, &self.choices, registry)?)
    }

    /// As [`PipelineSource::load_with`], restricted to the selected stages.
    ///
    /// # Errors
    /// All problems of the file, or the first pattern that matches no stage.
    pub fn select(
        &self,
        selection: &Selection,
        registry: &Registry,
        reading: &mut Reading<'_>,
    ) -> Result<Selected, Error> {
        let graph = self.load_with(registry, reading)?;
        Ok(selection.of(graph)?)
    }

    /// The default profile; `None` where the file has no profiles.
    ///
    /// # Errors
    /// All problems of the file.
    pub fn first_profile(&self) -> Result<Option<String>, Error> {
        let spec = read(&self.file, &mut Reading::default())?;
        Ok(spec.profiles().next().map(str::to_owned))
    }

    /// Resolves the file once for each of its profiles, with the environment of the choices.
    ///
    /// # Errors
    /// All problems of the file.
    pub fn load_all_profiles(&self, registry: &Registry) -> Result<Vec<Graph>, Error> {
        let spec = read(&self.file, &mut Reading::default())?;
        let mut profiles: Vec<Option<String>> =
            spec.profiles().map(|profile| Some(profile.to_owned())).collect();
        if profiles.is_empty() {
            profiles.push(None);
        }
        let mut graphs = Vec::new();
        for profile in profiles {
            let choices = Choices { profile, set: Vec::new(), ..self.choices.clone() };
            graphs.push(resolve::resolve(&spec, &choices, registry)?);
        }
        Ok(graphs)
    }

    /// The plan for the selected stages. [`PipelineSource::check_only`] checks it.
    ///
    /// # Errors
    /// No plan can be made.
    pub fn plan<'g>(&self, selected: &'g Selected, store: &Store) -> Result<Plan<'g>, Error> {
        Ok(plan::plan_forced(&selected.graph, store, &self.base(), selected.forced.clone())?)
    }

    /// Checks a plan for the selected stages against `--only`.
    ///
    /// # Errors
    /// It excludes a stage that would have to run.
    pub fn check_only(selected: &Selected, plan: &Plan<'_>) -> Result<(), Error> {
        let Selected { graph, must_be_cached, .. } = selected;
        let stale = plan.steps.iter().filter(|(stage, verdict)| {
            must_be_cached.contains(stage) && !matches!(verdict, Verdict::Cached { .. })
        });
        let stale: Vec<String> = stale.map(|(stage, _)| format!("`{}`", graph.stages[*stage].id)).collect();
        if let Some(first) = stale.first() {
            let more = if stale.len() > 1 { format!(" and {} more", stale.len() - 1) } else { String::new() };
            let message = format!("`--only` excludes {first}{more}, which is needed and not cached");
            return Err(Error::new(ErrorKind::Usage, message).hint("without `--only` it runs, too"));
        }
        Ok(())
    }

    /// The folder that paths in the pipeline file are relative to.
    pub fn base(&self) -> PathBuf {
        base_of(&self.file)
    }
}

/// Reads a pipeline file and the files that it includes.
fn read(file: &Path, reading: &mut Reading<'_>) -> Result<Spec, Error> {
    let name = SourceName(file.display().to_string());
    let bytes = fsx::read(file).map_err(|error| Diagnostics::unreadable(&name, &error.source))?;
    Ok(reading.parse(file, &bytes, &name)?)
}

fn base_of(file: &Path) -> PathBuf {
    match file.parent() {
        Some(folder) if !folder.as_os_str().is_empty() => folder.to_owned(),
        _ => PathBuf::from("."),
    }
}
