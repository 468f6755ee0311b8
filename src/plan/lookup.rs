//! Looks a stage up in the store: its key from the digests of its inputs, and what the store has under the key.

use std::collections::{BTreeMap, HashMap};
use std::sync::Arc;

use dril_stage_api::Labels;
use rayon::prelude::*;

use super::key::{KeyInput, KeyInputs, NoKey, key_of_record, named};
use super::{OutsideFile, Reason};
use crate::resolve::{Graph, Origin, Source, StageInstance};
use crate::store::{
    Digest, Found, History, Key, Outputs, Record, RecordInput, RecordItem, Store, StoreError,
};

/// Fewer stages than this are looked up faster on one thread.
const MANY: usize = 200;

/// The outputs of the stages that are done, by node index.
pub type Done = [Option<Arc<Outputs>>];

/// The result of looking a key up.
#[derive(Clone, Debug, PartialEq)]
pub enum Cached {
    /// Cache hit: all outputs are complete.
    Yes(Arc<Outputs>),
    /// Cache miss, with a reason unless there simply is no record.
    No(Option<Reason>),
}

/// The content of an artifact; `None` while the stage that makes it is not done.
pub fn digest_of(source: &Source, done: &Done, files: &BTreeMap<String, OutsideFile>) -> Option<Digest> {
    match &source.from {
        Origin::Stage { stage, output } => Some(done[stage.index()].as_ref()?.get(*output)?.digest),
        Origin::File { key, .. } => Some(files.get(key)?.digest),
    }
}

/// True for an executable file, where the stage can execute it or, as an import, passes it on: this is part of the key. Any other
/// built-in stage only reads its inputs.
pub fn is_executable(
    stage: &StageInstance,
    source: &Source,
    done: &Done,
    files: &BTreeMap<String, OutsideFile>,
) -> bool {
    (stage.kind.is_program() || stage.ports.outside.is_some())
        && match &source.from {
            Origin::Stage { stage, output } => done[stage.index()]
                .as_ref()
                .and_then(|outputs| outputs.get(*output))
                .is_some_and(|it| it.executable),
            Origin::File { key, .. } => files.get(key).is_some_and(|file| file.executable),
        }
}

/// A stage's key; `None` while some stage that feeds it is not done.
///
/// # Errors
/// Its parameters cannot enter a key.
pub fn key_of(
    stage: &StageInstance,
    done: &Done,
    files: &BTreeMap<String, OutsideFile>,
) -> Result<Option<Key>, NoKey> {
    let mut inputs = Vec::with_capacity(stage.inputs.len());
    for wire in &stage.inputs {
        let mut items: Vec<(Digest, &Labels)> = Vec::with_capacity(wire.sources.len());
        for source in &wire.sources {
            let Some(digest) = digest_of(source, done, files) else { return Ok(None) };
            items.push((named(&digest, is_executable(stage, source, done, files)), &source.labels));
        }
        inputs.push(KeyInput { port: wire.port, many: wire.many, items });
    }
    let work = KeyInputs {
        kind: stage.kind.name(),
        revision: stage.kind.revision(),
        params: &stage.params,
        seed: stage.seed.map(|seed| seed.0),
        inputs,
    };
    work.key().map(Some)
}

/// Looks a key up.
pub fn look_up(
    store: &Store,
    history: &History,
    stage: &StageInstance,
    key: &Key,
) -> Result<Cached, StoreError> {
    // Of an import, the record says whether the executable bit is in the key.
    let bit_matters =
        |outputs: &Outputs| stage.ports.outside.is_some() && outputs.values().any(|output| output.executable);
    let outputs = match history.outputs(key).filter(|outputs| !bit_matters(outputs)) {
        Some(outputs) if store.has_record(key)? => Arc::clone(outputs),
        Some(_) => return Ok(Cached::No(None)),
        None => match store.find(key)? {
            Found::Nothing => return Ok(Cached::No(None)),
            Found::Damaged(error) => return Ok(Cached::No(Some(Reason::Damaged { error }))),
            // An earlier version wrote it: a file that is not executable has this key.
            Found::Record(record) if bit_matters(&record.outputs) && !reads_executable(&record) => {
                return Ok(Cached::No(None));
            }
            Found::Record(record) if key_of_record(&record) == Ok(*key) => Arc::new(record.outputs),
            Found::Record(_) => {
                let error = "it is the record of another key".to_owned();
                return Ok(Cached::No(Some(Reason::Damaged { error })));
            }
        },
    };
    let missing = stage.ports.outputs.iter().find(|output| !outputs.contains_key(output.name));
    let lost = match missing {
        Some(output) => Some(output.name),
        None => store.lost(&outputs)?,
    };
    Ok(match lost {
        Some(output) => Cached::No(Some(Reason::Lost { output: output.to_owned() })),
        None => Cached::Yes(outputs),
    })
}

fn reads_executable(record: &Record) -> bool {
    record.inputs.iter().flat_map(|input| &input.items).any(|item| item.executable)
}

/// Looks up the last known key of every stage in parallel. Nearly all stages still have that key, and looking up is mostly
/// waiting for the system; the actual keys are computed one after the other. Errors are ignored here: they are reported if a
/// stage still has that key.
pub fn latest(graph: &Graph, store: &Store, history: &History) -> HashMap<Key, Arc<Outputs>> {
    let stages = graph.stages.node_weights();
    let stages = stages.filter_map(|stage| Some((stage, *history.earlier(&stage.id).next()?)));
    let stages: Vec<(&StageInstance, Key)> = stages.collect();
    let there = |(stage, key): &(&StageInstance, Key)| match look_up(store, history, stage, key) {
        Ok(Cached::Yes(outputs)) => Some((*key, outputs)),
        _ => None,
    };
    if stages.len() < MANY {
        return stages.iter().filter_map(there).collect();
    }
    stages.par_iter().filter_map(there).collect()
}

/// The inputs of a stage for its record; all its inputs are built.
pub fn record_inputs(
    graph: &Graph,
    stage: &StageInstance,
    done: &Done,
    files: &BTreeMap<String, OutsideFile>,
) -> Vec<RecordInput> {
    let input = |wire: &crate::resolve::Wire| RecordInput {
        port: wire.port.to_owned(),
        many: wire.many,
        items: wire
            .sources
            .iter()
            .filter_map(|source| {
                Some(RecordItem {
                    from: origin(graph, source),
                    labels: source.labels.clone(),
                    digest: digest_of(source, done, files)?,
                    executable: is_executable(stage, source, done, files),
                })
            })
            .collect(),
    };
    stage.inputs.iter().map(input).collect()
}

/// The origin of an artifact, for people: `dril[policy=beta].peak`, `file reference/table22.csv`, or both for an import:
/// `agent.content, file agents/beta.safetensors`.
pub fn origin(graph: &Graph, source: &Source) -> String {
    match &source.from {
        Origin::Stage { stage, output } => {
            let stage = &graph.stages[*stage];
            let outside = stage.ports.outside.as_ref();
            let file = outside.map_or_else(String::new, |outside| format!(", file {}", outside.path));
            format!("{}.{output}{file}", stage.id)
        }
        Origin::File { path, .. } => format!("file {path}"),
    }
}

/// The nearest earlier record of a stage: the latest in the pipeline's history that still exists.
pub fn earlier_record(store: &Store, history: &History, stage: &str) -> Result<Option<Record>, StoreError> {
    for key in history.earlier(stage) {
        if let Some(record) = store.record(key)? {
            return Ok(Some(record));
        }
    }
    Ok(None)
}
