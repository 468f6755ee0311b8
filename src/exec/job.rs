//! What a stage needs in order to run, from the graph: its job, the inputs that have to be laid out, and what its record
//! will say of its making.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use std::sync::Arc;

use dril_stage_api::{Artifact, Job, JobInput, JobOutput, Seed};

use super::dispatch::Shape;
use super::inputs::Placed;
use super::work::Site;
use crate::plan::{self, OutsideFile};
use crate::resolve::{self, Source, StageInstance, file_name};
use crate::store::{Fingerprint, Key, Outputs, RECORD_VERSION, Record};

/// The files from outside that a stage reads.
pub(super) fn outside<'a>(
    node: &'a StageInstance,
    shape: Shape<'a>,
) -> impl Iterator<Item = &'a OutsideFile> {
    node.inputs.iter().flat_map(|wire| &wire.sources).filter_map(move |source| match &source.from {
        resolve::From::File { key, .. } => shape.files.get(key),
        resolve::From::Stage { .. } => None,
    })
}

pub(super) fn job(
    node: &StageInstance,
    key: &Key,
    folder: &Path,
    done: &[Option<Arc<Outputs>>],
    shape: Shape<'_>,
    site: Site<'_>,
) -> (Job, Vec<Placed>) {
    let private = node.kind.is_program();
    let mut placed = Vec::new();
    let mut input = |port: &'static str, number: usize, source: &Source| {
        let digest = plan::digest_of(source, done, shape.files)?;
        let is_folder = is_folder(source, shape);
        let path = if private || is_folder {
            let to = folder.join("inputs").join(format!("{port}-{number}"));
            let executable = plan::is_executable(node, source, done, shape.files);
            placed.push(Placed { port, digest, to: to.clone(), is_folder, executable, private });
            to
        } else {
            site.store.blob_path(&digest)
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
        // A kind without randomness draws from no stream; the number only fills the field.
        seed: node.seed.unwrap_or(Seed(0)),
        inputs,
        outputs: outputs.collect(),
        scratch: folder.join("work"),
        checkpoints: site.store.checkpoints(key).join("files"),
        checkpoint_seconds: site.options.checkpoint_seconds,
        curves: site
            .options
            .curves
            .as_ref()
            .map(|folder| folder.join(file_name(&node.file_stem(), &format!("-{}", key.short())))),
    };
    (job, placed)
}

fn is_folder(source: &Source, shape: Shape<'_>) -> bool {
    match &source.from {
        resolve::From::File { folder, .. } => *folder,
        resolve::From::Stage { stage, output } => {
            let output = shape.graph.stages[*stage].ports.find_output(output);
            output.is_some_and(|output| output.artifact == Artifact::Folder)
        }
    }
}

pub(super) fn record(node: &StageInstance, done: &[Option<Arc<Outputs>>], shape: Shape<'_>) -> Record {
    Record {
        version: RECORD_VERSION,
        stage: node.id.as_ref().to_owned(),
        kind: node.kind.name().to_owned(),
        revision: node.kind.revision(),
        params: node.params.clone(),
        seed: node.seed.map(|seed| seed.0),
        inputs: plan::record_inputs(shape.graph, node, done, shape.files),
        outputs: Outputs::new(),
        seconds: 0.0,
        fingerprint: Fingerprint::current(),
    }
}

/// Where a stage writes an output.
pub(super) fn output_path(folder: &Path, name: &str, extension: &str) -> PathBuf {
    let ending = if extension.is_empty() { "" } else { "." };
    folder.join(format!("output-{name}{ending}{extension}"))
}
