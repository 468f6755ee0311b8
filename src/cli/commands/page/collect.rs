//! Collects the results of a pipeline as plain data.

use std::collections::BTreeMap;
use std::path::Path;

use dril_stage_api::Kind;
use dril_stage_api::outcome::{InputOutcome, OutputOutcome, PipelineOutcome, StageOutcome, State};
use serde_json::Value;

use super::folders::Folders;
use crate::cli::args::PipelineArgs;
use crate::cli::commands::inspect::failures::Failures;
use crate::cli::pipeline;
use crate::error::Error;
use crate::fsx;
use crate::plan::{self, Plan, Verdict};
use crate::resolve::{Graph, Origin, StageIndex, StageInstance};
use crate::session;
use crate::store::{Record, Store};

/// The current results of a pipeline; `folder` is the folder of the page, so that it can link to files there.
pub(super) fn outcome(
    args: &PipelineArgs,
    graph: &Graph,
    store: &Store,
    folder: &Path,
) -> Result<PipelineOutcome, Error> {
    let plan = plan::plan(graph, store, &pipeline::source(args).base())?;
    let base = pipeline::source(args).base();
    let failures = Failures::of(&plan, store)?;
    let folders = Folders::new(store.root(), &base);
    let viewer = Viewer { plan: &plan, store, base: &base, failures, folders, files: files(graph, folder) };
    let stages = graph.stages.node_indices().map(|stage| viewer.stage(stage)).collect::<Result<_, _>>()?;
    Ok(PipelineOutcome {
        pipeline: graph.pipeline.clone(),
        profile: graph.profile.clone(),
        first_profile: pipeline::source(args).first_profile()?,
        command: command(args),
        tool: format!("dril-pipe {}", env!("CARGO_PKG_VERSION")),
        stages,
    })
}

/// The arguments that name the pipeline on a command line. Of an absolute path, which would reveal the user's folders, only the
/// file name is used.
fn command(args: &PipelineArgs) -> Vec<String> {
    let file = if args.file.is_absolute() { args.file.file_name().map(Path::new) } else { None };
    let mut words = vec![file.unwrap_or(&args.file).display().to_string()];
    let choices = args.choices();
    words.extend(choices.profile.into_iter().flat_map(|profile| ["--profile".to_owned(), profile]));
    words.extend(choices.set.into_iter().flat_map(|set| ["--set".to_owned(), set]));
    words
}

/// The names of the results that exist in the folder, by stage and output.
fn files(graph: &Graph, folder: &Path) -> BTreeMap<(String, String), String> {
    let mut files = session::file_names(graph);
    files.retain(|_, name| matches!(fsx::entry(&folder.join(name)), Ok(Some(fsx::Entry::File(_)))));
    files
}

struct Viewer<'a> {
    plan: &'a Plan<'a>,
    store: &'a Store,
    /// The folder that external files are relative to.
    base: &'a Path,
    failures: Failures,
    /// The folders that messages must not show.
    folders: Folders,
    files: BTreeMap<(String, String), String>,
}

impl Viewer<'_> {
    fn stage(&self, index: StageIndex) -> Result<StageOutcome, Error> {
        let stage = &self.plan.graph.stages[index];
        let (state, key, record) = match self.plan.verdict(index) {
            Some(Verdict::Cached { key, .. }) => (State::Done, Some(*key), self.store.record(key)?),
            Some(Verdict::Run { key, .. }) if self.store.is_being_made(key) => {
                (State::Running, Some(*key), None)
            }
            Some(Verdict::Run { key, .. }) => match self.failures.message(key) {
                Some(message) => (State::Failed(self.folders.hide(message)), Some(*key), None),
                None => (State::Stale, Some(*key), None),
            },
            _ => (State::Waiting, None, None),
        };
        Ok(StageOutcome {
            name: stage.name.to_string(),
            id: stage.id.to_string(),
            labels: stage.coordinates.clone(),
            kind: stage.kind.name().to_owned(),
            revision: stage.kind.revision(),
            chosen: chosen(&stage.kind, &stage.params),
            params: stage.params.clone(),
            seed: stage.seed.map(|seed| seed.0),
            state,
            key: key.map(|key| key.hex()),
            inputs: inputs(stage, self.base),
            outputs: record.as_ref().map_or_else(Vec::new, |record| self.outputs(stage, record)),
            seconds: record.as_ref().map(|record| record.seconds),
            made_with: record.map(made_with).unwrap_or_default(),
        })
    }

    fn outputs(&self, stage: &StageInstance, record: &Record) -> Vec<OutputOutcome> {
        let output = |port: &dril_stage_api::Output| {
            let stored = record.outputs.get(port.name).filter(|stored| !stored.folder)?;
            let place = (stage.id.to_string(), port.name.to_owned());
            Some(OutputOutcome {
                name: port.name.to_owned(),
                artifact: port.artifact,
                extension: port.extension.to_owned(),
                digest: stored.digest.hex(),
                bytes: stored.bytes,
                path: self.store.blob_path(&stored.digest),
                file: self.files.get(&place).cloned(),
            })
        };
        stage.ports.outputs.iter().filter_map(output).collect()
    }
}

fn inputs(stage: &StageInstance, base: &Path) -> Vec<InputOutcome> {
    let sources = stage.inputs.iter().flat_map(|wire| wire.sources.iter().map(|source| (wire.port, source)));
    let input = |(port, source): (&'static str, &crate::resolve::Source)| {
        let (stage, from, path) = match &source.from {
            Origin::Stage { stage, output } => (Some(stage.index()), (*output).to_owned(), None),
            Origin::File { path, .. } => (None, path.clone(), Some(base.join(path))),
        };
        InputOutcome { port: port.to_owned(), stage, from, labels: source.labels.clone(), path }
    };
    sources.map(input).collect()
}

/// The parameters that differ from the kind's defaults.
fn chosen(kind: &Kind, params: &Value) -> BTreeMap<String, Value> {
    let schema = kind.schema();
    let defaults = schema.get("properties").cloned().unwrap_or_default();
    let all = params.as_object().into_iter().flatten();
    let differs =
        |name: &str, value: &Value| defaults.get(name).and_then(|field| field.get("default")) != Some(value);
    all.filter(|(name, value)| differs(name, value))
        .map(|(name, value)| (name.clone(), value.clone()))
        .collect()
}

fn made_with(record: Record) -> BTreeMap<String, String> {
    let mut with = record.fingerprint.with;
    with.insert("dril-pipe".to_owned(), record.fingerprint.tool);
    with.insert("on".to_owned(), record.fingerprint.platform);
    with
}
