//! From the graph to what a stage needs in order to run: its job file, the inputs to lay out in its folder, and the draft of
//! its record.

use std::collections::BTreeMap;
use std::path::Path;
use std::sync::Arc;

use dril_stage_api::{Artifact, Job, JobInput, JobOutput, Seed};

use super::context::RunContext;
use super::inputs::Placed;
use super::publish::output_path;
use crate::plan::{self, OutsideFile};
use crate::resolve::{self, Source, StageInstance, file_name};
use crate::store::{Fingerprint, Key, Outputs, RECORD_VERSION, Record};

/// Files from outside that a stage reads.
pub(super) fn outside<'a>(
    node: &'a StageInstance,
    context: RunContext<'a>,
) -> impl Iterator<Item = &'a OutsideFile> {
    node.inputs.iter().flat_map(|wire| &wire.sources).filter_map(move |source| match &source.from {
        resolve::Origin::File { key, .. } => context.files.get(key),
        resolve::Origin::Stage { .. } => None,
    })
}

/// The job file of a stage whose inputs are all built, and the inputs to lay out in its folder.
pub(super) fn job(
    node: &StageInstance,
    key: &Key,
    folder: &Path,
    done: &[Option<Arc<Outputs>>],
    context: RunContext<'_>,
) -> (Job, Vec<Placed>) {
    let private = node.kind.is_program();
    let mut placed = Vec::new();
    let mut input = |port: &'static str, number: usize, source: &Source| {
        let digest = plan::digest_of(source, done, context.files)?;
        let is_folder = is_folder(source, context);
        let path = if private || is_folder {
            let to = folder.join("inputs").join(format!("{port}-{number}"));
            let executable = plan::is_executable(node, source, done, context.files);
            placed.push(Placed { port, digest, to: to.clone(), is_folder, executable, private });
            to
        } else {
            context.store.blob_path(&digest)
        };
        Some(JobInput { path, labels: source.labels.clone() })
    };
    let mut inputs = BTreeMap::new();
    for wire in &node.inputs {
        let items = wire.sources.iter().enumerate();
        let items = items.filter_map(|(number, source)| input(wire.port, number, source)).collect();
        inputs.insert(wire.port.to_owned(), items);
    }
    let outputs = node.ports.outputs.iter().map(|output| {
        (output.name.to_owned(), JobOutput { path: output_path(folder, output.name, output.extension) })
    });
    let job = Job {
        stage: node.id.as_ref().to_owned(),
        kind: node.kind.name().to_owned(),
        revision: node.kind.revision(),
        params: node.params.clone(),
        // A kind without randomness never draws: the number only fills the field.
        seed: node.seed.unwrap_or(Seed(0)),
        inputs,
        outputs: outputs.collect(),
        scratch: folder.join("work"),
        checkpoints: context.store.checkpoints(key).join("files"),
        checkpoint_seconds: context.options.checkpoint_seconds,
        curves: context
            .options
            .curves
            .as_ref()
            .map(|folder| folder.join(file_name(&node.file_stem(), &format!("-{}", key.short())))),
    };
    (job, placed)
}

fn is_folder(source: &Source, context: RunContext<'_>) -> bool {
    match &source.from {
        resolve::Origin::File { folder, .. } => *folder,
        resolve::Origin::Stage { stage, output } => {
            let output = context.graph.stages[*stage].ports.find_output(output);
            output.is_some_and(|output| output.artifact == Artifact::FOLDER)
        }
    }
}

/// The record of a stage that is about to run; outputs and duration are filled in afterwards.
pub(super) fn record(node: &StageInstance, done: &[Option<Arc<Outputs>>], context: RunContext<'_>) -> Record {
    Record {
        version: RECORD_VERSION,
        stage: node.id.as_ref().to_owned(),
        kind: node.kind.name().to_owned(),
        revision: node.kind.revision(),
        params: node.params.clone(),
        seed: node.seed.map(|seed| seed.0),
        inputs: plan::record_inputs(context.graph, node, done, context.files),
        outputs: Outputs::new(),
        seconds: 0.0,
        fingerprint: Fingerprint::current(),
    }
}
