//! Copies tables and figures out of the store into the results folder, and takes away what a changed pipeline no longer
//! makes. A note in the folder lists what is ours; nothing else in it is touched.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

use serde::{Deserialize, Serialize};

use crate::error::Error;
use crate::fsx;
use crate::resolve::Graph;
use crate::store::{Digest, Outputs, Store, Stored};

/// The note's file name.
const NOTE: &str = ".dril-pipe.json";
/// The version of the note's format.
const NOTE_VERSION: u32 = 1;

/// What stands in the results folder, and what made it.
#[derive(Debug, Clone, Default, PartialEq, Eq, Serialize, Deserialize)]
struct Note {
    version: u32,
    pipeline: String,
    profile: String,
    files: BTreeMap<String, Entry>,
}

/// One file of the results folder.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
struct Entry {
    stage: String,
    output: String,
    digest: Digest,
}

/// What came of it.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub(super) struct Published {
    /// The results folder.
    pub folder: PathBuf,
    /// Files there that this pipeline made.
    pub files: usize,
    /// Files that are of an earlier run, because their stage did not finish in this one.
    pub earlier: Vec<String>,
    /// Files that were removed because the pipeline does not make them any more.
    pub removed: Vec<String>,
}

/// Where the results of a pipeline go without `--out`.
pub(super) fn default_folder(graph: &Graph) -> PathBuf {
    Path::new("results").join(format!("{}-{}", graph.pipeline, graph.profile))
}

/// Brings the folder up to date with the outputs of the stages that are done; `None` where there is
/// nothing to copy and nothing was.
///
/// # Errors
/// The folder cannot be written, or the store not read.
pub(super) fn publish<'a>(
    folder: &Path,
    graph: &Graph,
    store: &Store,
    outputs: impl Fn(crate::resolve::StageIndex) -> Option<&'a Outputs>,
) -> Result<Option<Published>, Error> {
    let old = read_note(folder)?;
    let wanted = wanted(graph, outputs);
    if wanted.values().all(|(_, stored)| stored.is_none()) && old.files.is_empty() {
        return Ok(None);
    }
    let mut note = Note {
        version: NOTE_VERSION,
        pipeline: graph.pipeline.clone(),
        profile: graph.profile.clone(),
        files: BTreeMap::new(),
    };
    let mut published = Published { folder: folder.to_owned(), ..Published::default() };
    fsx::create_dir_all(folder)?;
    for (name, (entry, stored)) in wanted {
        if let Some(stored) = stored {
            let path = folder.join(&name);
            if !holds(&path, &stored.digest)? {
                fsx::copy_atomic(&store.blob_path(&stored.digest), &path)?;
            }
            note.files.insert(name, Entry { digest: stored.digest, ..entry });
        } else if let Some(entry) = old.files.get(&name) {
            note.files.insert(name.clone(), entry.clone());
            published.earlier.push(name);
        }
    }
    published.files = note.files.len();
    published.removed = remove_stale(folder, &old, &note)?;
    if note != old {
        fsx::write_atomic(&folder.join(NOTE), to_json(&note).as_bytes())?;
    }
    Ok(Some(published))
}

/// True where the folder has so many results, each as its note says.
///
/// # Errors
/// The folder cannot be read.
pub(super) fn are_whole(folder: &Path, files: usize) -> Result<bool, Error> {
    let note = read_note(folder)?;
    for (name, entry) in &note.files {
        if !holds(&folder.join(name), &entry.digest)? {
            return Ok(false);
        }
    }
    Ok(note.files.len() == files)
}

/// The names that the results of a graph have in its folder, by stage and output.
pub(super) fn file_names(graph: &Graph) -> BTreeMap<(String, String), String> {
    let wanted = wanted(graph, |_| None).into_iter();
    wanted.map(|(name, (entry, _))| ((entry.stage, entry.output), name)).collect()
}

/// The results of a graph by file name; with what is stored, where the stage is done.
fn wanted<'a>(
    graph: &Graph,
    outputs: impl Fn(crate::resolve::StageIndex) -> Option<&'a Outputs>,
) -> BTreeMap<String, (Entry, Option<&'a Stored>)> {
    let mut wanted = BTreeMap::new();
    for index in graph.stages.node_indices() {
        let stage = &graph.stages[index];
        for output in stage.ports.outputs.iter().filter(|output| output.artifact.is_result()) {
            let mut name = format!("{}.{}", stage.file_stem(), output.extension);
            for number in 1.. {
                // Two outputs of one ending, or names that differ only in characters that files should not have.
                if !wanted.contains_key(&name) {
                    break;
                }
                let more = if number == 1 { String::new() } else { format!("-{number}") };
                name = format!("{}-{}{more}.{}", stage.file_stem(), output.name, output.extension);
            }
            let stored = outputs(index).and_then(|outputs| outputs.get(output.name));
            // The digest of an unfinished stage is never used.
            let digest = stored.map_or_else(|| Digest::of(&[]), |stored| stored.digest);
            let entry = Entry { stage: stage.id.to_string(), output: output.name.to_owned(), digest };
            wanted.insert(name, (entry, stored));
        }
    }
    wanted
}

/// True where the file has that content already.
fn holds(path: &Path, digest: &Digest) -> Result<bool, Error> {
    match fsx::entry(path)? {
        Some(fsx::Entry::File(_)) => {
            let bytes = fsx::read_if_there(path)?;
            Ok(bytes.is_some_and(|bytes| Digest::of(&bytes) == *digest))
        }
        _ => Ok(false),
    }
}

/// Removes what the old note lists and the new one does not, unless somebody has changed it since.
fn remove_stale(folder: &Path, old: &Note, new: &Note) -> Result<Vec<String>, Error> {
    let mut removed = Vec::new();
    for (name, entry) in old.files.iter().filter(|(name, _)| !new.files.contains_key(*name)) {
        // A note is a file that anybody can edit: it must not reach out of its folder.
        let is_plain_name = Path::new(name).file_name().is_some_and(|file| file == name.as_str());
        let path = folder.join(name);
        if is_plain_name && holds(&path, &entry.digest)? && fsx::remove_file(&path)? {
            removed.push(name.clone());
        }
    }
    Ok(removed)
}

/// The note of a folder; an empty one where there is none that can be read.
fn read_note(folder: &Path) -> Result<Note, Error> {
    let bytes = fsx::read_if_there(&folder.join(NOTE))?;
    let note = bytes.and_then(|bytes| serde_json::from_slice::<Note>(&bytes).ok());
    Ok(note.filter(|note| note.version == NOTE_VERSION).unwrap_or_default())
}

fn to_json(note: &Note) -> String {
    // Strings, numbers and maps with string keys: there is nothing in a note that JSON cannot say.
    serde_json::to_string_pretty(note).map(|text| text + "\n").unwrap_or_default()
}
