//! Recognises a run in which nothing changed, without reading the pipeline: a complete run stores a fingerprint of
//! everything that its plan was made from. If all of that is the same, only records, blobs and results are checked.
//!
//! Whatever could make a difference and is not known to be the same leads to a normal run.

use std::borrow::Cow;
use std::collections::{BTreeMap, BTreeSet};
use std::path::{Path, PathBuf};

use serde::{Deserialize, Serialize};

use super::locking::LockMode;
use super::noticed::Noticed;
use super::results::{self, Published};
use super::source::PipelineSource;
use super::{lockfile, program};
use crate::error::Error;
use crate::exec::Executed;
use crate::fsx;
use crate::plan::{self, Plan, Warning};
use crate::resolve::{Graph, Selection};
use crate::store::{CompleteRun, Digest, Store, hash_file};

/// Larger files are not hashed just to save time.
const LARGEST: u64 = 16 << 20;

/// What a complete run stores beside keys and digests.
#[derive(Debug, Serialize, Deserialize)]
struct Note<'n> {
    pipeline: String,
    profile: String,
    /// Included files and files from outside, with their digests (see [`files_of`]).
    files: BTreeMap<PathBuf, Digest>,
    /// The environment variables that stages name, each with the digest of its value.
    variables: BTreeMap<String, Option<Digest>>,
    results: Option<PathBuf>,
    result_files: usize,
    noticed: Cow<'n, Noticed>,
}

/// What a run knows of its circumstances from its beginning.
pub(super) struct Known<'l> {
    /// Included files and files from outside as they were read: one that has changed since must not be mistaken for them.
    pub files: BTreeMap<PathBuf, Digest>,
    /// Its warnings.
    pub noticed: &'l Noticed,
}

/// A run with nothing to do: everything is cached and the results are in place.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct UpToDate {
    /// The pipeline's name.
    pub pipeline: String,
    /// Its profile.
    pub profile: String,
    /// Number of stages.
    pub stages: u64,
    /// The results folder; `None` where the pipeline has no results.
    pub results: Option<PathBuf>,
    /// Number of files there.
    pub result_files: usize,
    /// What the plan of the run would warn of.
    pub warnings: Vec<Warning>,
    /// The resources that stages ask for.
    pub resources: BTreeSet<String>,
}

/// Everything that decides about a run and is known before the pipeline is read.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct RunFingerprint {
    name: Digest,
    made_from: Digest,
}

impl RunFingerprint {
    /// The fingerprint of a run; `None` where the run needs the full plan.
    pub fn of(
        source: &PipelineSource,
        selection: &Selection,
        lock: LockMode,
        out: Option<&Path>,
    ) -> Option<Self> {
        if lock != LockMode::Update || !selection.is_all() {
            return None;
        }
        let text = fsx::read(&source.file).ok()?;
        let lock = fsx::read_if_there(&lockfile::path_of(&source.file)).ok()?;
        let here = std::env::current_dir().ok()?;
        // The values of the variables that stages name are compared with the note instead.
        let choices = format!("{:?}", (&source.choices.profile, &source.choices.set));
        let mut name = blake3::Hasher::new_derive_key("dril-pipe unchanged run v1");
        for part in [here.join(&source.file).as_os_str(), here.as_os_str()] {
            add(&mut name, part.as_encoded_bytes());
        }
        add(&mut name, format!("{out:?}").as_bytes());
        add(&mut name, choices.as_bytes());
        let mut made_from = name.clone();
        add(&mut made_from, &text);
        // So that a file that changes while it is read is not mistaken for its old version.
        add(&mut made_from, fsx::identity(&source.file).ok()?.as_bytes());
        add(&mut made_from, lock.as_deref().unwrap_or(b"none"));
        add(&mut made_from, program::identity()?.as_bytes());
        let digest = |hasher: &blake3::Hasher| Digest::new(*hasher.finalize().as_bytes());
        Some(Self { name: digest(&name), made_from: digest(&made_from) })
    }

    /// Looks the fingerprint up; `None` where something may have changed.
    pub fn look_up(&self, source: &PipelineSource, store: &Store) -> Result<Option<UpToDate>, Error> {
        let _held = store.hold()?;
        let Some(complete) = store.complete_run(&self.name, &self.made_from)? else { return Ok(None) };
        let Ok(note) = serde_json::from_slice::<Note<'_>>(&complete.note) else { return Ok(None) };
        if note.variables.iter().any(|(name, value)| variable(source, name) != *value) {
            return Ok(None);
        }
        for (path, digest) in &note.files {
            if hash_small(path) != Some(*digest) {
                return Ok(None);
            }
        }
        if !note.noticed.still_holds() {
            return Ok(None);
        }
        if let Some(folder) = &note.results
            && !results::are_whole(folder, note.result_files)?
        {
            return Ok(None);
        }
        // The history may have other keys as the latest ones: those of the last run with other choices. It is touched, too, for
        // versions of this program that look only there.
        store.touch_complete_run(&self.name);
        store.touch_history(&note.pipeline, &note.profile);
        let Note { pipeline, profile, results, result_files, noticed, .. } = note;
        let Noticed { warnings, resources, .. } = noticed.into_owned();
        let stages = complete.stages;
        Ok(Some(UpToDate { pipeline, profile, stages, results, result_files, warnings, resources }))
    }

    /// Stores a complete run for the next one. Failing to store it is not an error.
    pub fn keep(
        &self,
        source: &PipelineSource,
        graph: &Graph,
        store: &Store,
        known: Known<'_>,
        executed: &Executed,
        published: Option<&Published>,
    ) {
        let note = Note {
            pipeline: graph.pipeline.clone(),
            profile: graph.profile.clone(),
            files: known.files,
            variables: variables(source, graph),
            results: published.map(|published| published.folder.clone()),
            result_files: published.map_or(0, |published| published.files),
            noticed: Cow::Borrowed(known.noticed),
        };
        let Ok(note) = serde_json::to_vec(&note) else { return };
        let outputs = executed.outputs.iter().flatten().flat_map(|outputs| outputs.values());
        let contents: Result<Vec<_>, _> = outputs.map(|stored| store.contents(stored)).collect();
        let Ok(contents) = contents else { return };
        let complete = CompleteRun {
            stages: graph.stages.node_count() as u64,
            note,
            keys: executed.keys.iter().flatten().copied().collect(),
            contents: contents.into_iter().flatten().collect(),
        };
        let _ = store.keep_complete_run(&self.name, &self.made_from, &complete);
    }
}

fn hash_small(path: &Path) -> Option<Digest> {
    match fsx::entry(path) {
        Ok(Some(fsx::Entry::File(bytes))) if bytes <= LARGEST => {
            let executable = fsx::is_executable(path).ok()?;
            hash_file(path).ok().map(|(digest, _)| plan::named(&digest, executable))
        }
        _ => None,
    }
}

/// The files that a plan was made from: included files (`parts`) and files from outside, each with a digest that covers its
/// content and whether it is executable.
pub(super) fn files_of(parts: &BTreeMap<PathBuf, Digest>, plan: &Plan<'_>) -> BTreeMap<PathBuf, Digest> {
    let executable = |path: &PathBuf| fsx::is_executable(path).unwrap_or(false);
    let parts = parts.iter().map(|(path, digest)| (path.clone(), plan::named(digest, executable(path))));
    let outside = plan.files.values();
    let outside = outside.map(|file| (file.path.clone(), plan::named(&file.digest, file.executable)));
    parts.chain(outside).collect()
}

/// The environment variables that stages name. The pipeline file may set some of them itself; checking these, too, costs
/// nothing.
fn variables(source: &PipelineSource, graph: &Graph) -> BTreeMap<String, Option<Digest>> {
    let named = graph.stages.node_weights().filter_map(|stage| {
        let field = stage.kind.environment()?;
        stage.params.get(field)?.as_object()
    });
    named.flat_map(|named| named.keys()).map(|name| (name.clone(), variable(source, name))).collect()
}

fn variable(source: &PipelineSource, name: &str) -> Option<Digest> {
    source.choices.environment.get(name).map(|value| Digest::of(value.as_bytes()))
}

fn add(hasher: &mut blake3::Hasher, bytes: &[u8]) {
    hasher.update(&(bytes.len() as u64).to_le_bytes());
    hasher.update(bytes);
}
