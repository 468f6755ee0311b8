//! A run in which nothing changed, told without reading the pipeline: a complete run leaves a note of all that its plan
//! was made from, and where every bit of that is the same, only records, contents and results are looked for.
//!
//! Whatever could make a difference and is not known to be the same leads to the long way.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use std::time::{Duration, Instant};

use serde::{Deserialize, Serialize};

use super::args::RunArgs;
use super::results::{self, Published};
use super::terminal::{Style, Terminal, count, duration, print, shown};
use super::{lockfile, pipeline};
use crate::error::Error;
use crate::exec::Executed;
use crate::fsx;
use crate::plan::{self, Plan};
use crate::resolve::Graph;
use crate::store::{Digest, Settled, Store, hash_file};

/// More bytes than this are not hashed to save time.
const LARGEST: u64 = 16 << 20;

/// What is told of such a run.
#[derive(Debug, Serialize, Deserialize)]
struct Note {
    pipeline: String,
    profile: String,
    /// Files that the pipeline file includes and files from outside, as the long way found them (see [`read_from`]).
    files: BTreeMap<PathBuf, Digest>,
    /// The variables that stages name, each with the digest of its value.
    variables: BTreeMap<String, Option<Digest>>,
    results: Option<PathBuf>,
    result_files: usize,
}

/// The circumstances of a run, as far as they are known before the pipeline is read.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct Circumstances {
    name: Digest,
    made_from: Digest,
}

impl Circumstances {
    /// Of this run; `None` where it wants something that needs the long way.
    pub fn of(args: &RunArgs) -> Option<Self> {
        // Without `..`: whoever adds an argument has to say here whether it can make a difference.
        let RunArgs {
            pipeline,
            select,
            store: _,
            out,
            jobs: _,
            resources: _,
            checkpoint_every: _,
            tensorboard: _,
            fail_fast: _,
            keep_going: _,
            dry_run,
            time: _,
            check_determinism,
            lock,
            locked,
            json,
            quiet: _,
        } = args;
        if *check_determinism || *lock || *locked || *json || *dry_run || !select.selection().is_all() {
            return None;
        }
        let source = fsx::read(&pipeline.file).ok()?;
        let lock = fsx::read_if_there(&lockfile::path_of(&pipeline.file)).ok()?;
        let here = std::env::current_dir().ok()?;
        let choices = format!("{:?}", pipeline.choices());
        let mut name = blake3::Hasher::new_derive_key("dril-pipe unchanged run v1");
        for part in [here.join(&pipeline.file).as_os_str(), here.as_os_str()] {
            part_of(&mut name, part.as_encoded_bytes());
        }
        part_of(&mut name, format!("{out:?}").as_bytes());
        part_of(&mut name, choices.as_bytes());
        let mut made_from = name.clone();
        part_of(&mut made_from, &source);
        // So that a file which was changed while it was read is not taken for what it was before.
        part_of(&mut made_from, fsx::identity(&pipeline.file).ok()?.as_bytes());
        part_of(&mut made_from, lock.as_deref().unwrap_or(b"none"));
        part_of(&mut made_from, program()?.as_bytes());
        let digest = |hasher: &blake3::Hasher| Digest::new(*hasher.finalize().as_bytes());
        Some(Self { name: digest(&name), made_from: digest(&made_from) })
    }

    /// Tells that nothing is to be done, if that is so. False leads to the long way.
    pub fn tell(&self, args: &RunArgs, began: Instant) -> Result<bool, Error> {
        let store = pipeline::store(&args.store)?;
        let _held = store.hold()?;
        let Some(settled) = store.settled(&self.name, &self.made_from)? else { return Ok(false) };
        let Ok(note) = serde_json::from_slice::<Note>(&settled.note) else { return Ok(false) };
        if note.variables.iter().any(|(name, value)| variable(name) != *value) {
            return Ok(false);
        }
        for (path, digest) in &note.files {
            if hash_small(path) != Some(*digest) {
                return Ok(false);
            }
        }
        if let Some(folder) = &note.results
            && !results::are_whole(folder, note.result_files)?
        {
            return Ok(false);
        }
        store.touch_history(&note.pipeline, &note.profile);
        if !args.quiet {
            print(&text(&note, settled.stages, began.elapsed()))?;
        }
        Ok(true)
    }

    /// Notes a complete run for the next one; `files` are those that the pipeline file includes and those from
    /// outside, as they were found: one that was changed in the meantime must not be taken for them. That it cannot be noted is no error.
    pub fn note(
        &self,
        graph: &Graph,
        store: &Store,
        files: BTreeMap<PathBuf, Digest>,
        executed: &Executed,
        published: Option<&Published>,
    ) {
        let note = Note {
            pipeline: graph.pipeline.clone(),
            profile: graph.profile.clone(),
            files,
            variables: variables(graph),
            results: published.map(|published| published.folder.clone()),
            result_files: published.map_or(0, |published| published.files),
        };
        let Ok(note) = serde_json::to_vec(&note) else { return };
        let outputs = executed.outputs.iter().flatten().flat_map(|outputs| outputs.values());
        let contents: Result<Vec<_>, _> = outputs.map(|stored| store.contents(stored)).collect();
        let Ok(contents) = contents else { return };
        let settled = Settled {
            stages: graph.stages.node_count() as u64,
            note,
            keys: executed.keys.iter().flatten().copied().collect(),
            contents: contents.into_iter().flatten().collect(),
        };
        let _ = store.settle(&self.name, &self.made_from, &settled);
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

/// The files that a plan was made from, by path: those that the pipeline file includes (`parts`) and those from outside.
/// Each is called by its content, and whether it may be executed.
pub(super) fn read_from(parts: &BTreeMap<PathBuf, Digest>, plan: &Plan<'_>) -> BTreeMap<PathBuf, Digest> {
    let executable = |path: &PathBuf| fsx::is_executable(path).unwrap_or(false);
    let parts = parts.iter().map(|(path, digest)| (path.clone(), plan::named(digest, executable(path))));
    let outside = plan.files.values();
    let outside = outside.map(|file| (file.path.clone(), plan::named(&file.digest, file.executable)));
    parts.chain(outside).collect()
}

/// The variables whose values enter the parameters of stages. Some have a value in the pipeline file instead; to look at
/// those, too, costs nothing.
fn variables(graph: &Graph) -> BTreeMap<String, Option<Digest>> {
    let named = graph.stages.node_weights().filter_map(|stage| {
        let field = stage.kind.environment()?;
        stage.params.get(field)?.as_object()
    });
    named.flat_map(|named| named.keys()).map(|name| (name.clone(), variable(name))).collect()
}

fn variable(name: &str) -> Option<Digest> {
    std::env::var_os(name).map(|value| Digest::of(value.as_encoded_bytes()))
}

/// Which build of this program runs: another one may plan otherwise.
pub(super) fn program() -> Option<String> {
    let path = std::env::current_exe().ok()?;
    fsx::identity(&path).ok()
}

fn part_of(hasher: &mut blake3::Hasher, bytes: &[u8]) {
    hasher.update(&(bytes.len() as u64).to_le_bytes());
    hasher.update(bytes);
}

/// What the long way tells of a run without work.
fn text(note: &Note, stages: u64, took: Duration) -> String {
    let terminal = Terminal::stdout();
    let title = terminal.paint(Style::Strong, &format!("{}, profile {}", note.pipeline, note.profile));
    let stages = usize::try_from(stages).unwrap_or(usize::MAX);
    let nothing = terminal.paint(Style::Good, "nothing to do");
    let mut text = format!("{title}: {}, {stages} cached\n", count(stages, "stage"));
    text += &format!("{nothing}: 0 stages executed, all {stages} cached, in {}\n", duration(took));
    if let Some(folder) = &note.results {
        text += &format!("results: {} ({})\n", shown(folder), count(note.result_files, "file"));
    }
    text
}
