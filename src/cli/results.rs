//! Copies tables and figures out of the store into the results folder, and takes away what a changed pipeline no longer
//! makes. A note in the folder lists what is ours; nothing else in it is touched.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

use serde::{Deserialize, Serialize};

use crate::error::{Error, ErrorKind};
use crate::fsx;
use crate::resolve::{Graph, file_name};
use crate::store::{Digest, Outputs, Store, Stored};

/// The note's file name.
const NOTE: &str = ".dril-pipe.json";
/// The version of the note's format.
const NOTE_VERSION: u32 = 1;

/// With an output's name and ending behind it, a stem of so many bytes still fits.
const SURELY_SHORT: usize = 120;

/// What stands in the results folder, and what made it.
#[derive(Debug, Clone, Default, PartialEq, Eq, Serialize, Deserialize)]
struct Note {
    version: u32,
    pipeline: String,
    profile: String,
    /// The pipeline file, relative to this folder; older notes have none.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    source: Option<String>,
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
    file: &Path,
    graph: &Graph,
    store: &Store,
    outputs: impl Fn(crate::resolve::StageIndex) -> Option<&'a Outputs>,
) -> Result<Option<Published>, Error> {
    let old = read_note(folder)?;
    let wanted = wanted(graph, outputs);
    if wanted.values().all(|(_, stored)| stored.is_none()) && old.files.is_empty() {
        return Ok(None);
    }
    fsx::create_dir_all(folder)?;
    let mut note = Note {
        version: NOTE_VERSION,
        pipeline: graph.pipeline.clone(),
        profile: graph.profile.clone(),
        source: source(folder, file),
        files: BTreeMap::new(),
    };
    let mut published = Published { folder: folder.to_owned(), ..Published::default() };
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
    // What another profile made is still made by it.
    if old.profile == note.profile {
        published.removed = remove_stale(folder, &old, &note)?;
    }
    if note != old {
        fsx::write_atomic(&folder.join(NOTE), to_json(&note).as_bytes())?;
    }
    Ok(Some(published))
}

/// Refuses a folder in which the results of another pipeline file are: two files of one `name` would remove each other's.
/// A file that is not there any more has no results to lose; nor has one that is the same under another name.
///
/// # Errors
/// The folder belongs to another file.
pub(super) fn check_owner(folder: &Path, file: &Path, graph: &Graph) -> Result<(), Error> {
    // A folder that cannot be read is told when results are to be put there: that is no reason to lose the work.
    let note = read_note(folder).unwrap_or_default();
    let Some(other) = note.source.filter(|_| !note.files.is_empty()).map(|source| folder.join(source)) else {
        return Ok(());
    };
    let (Some(other), Some(own)) = (fsx::real(&other), fsx::real(file)) else { return Ok(()) };
    if other == own || fsx::identity(&other)? == fsx::identity(&own)? {
        return Ok(());
    }
    let has_results = graph
        .stages
        .node_weights()
        .flat_map(|stage| &stage.ports.outputs)
        .any(|output| output.artifact.is_result());
    if !has_results {
        return Ok(());
    }
    let here =
        std::env::current_dir().ok().and_then(|here| other.strip_prefix(here).ok().map(Path::to_owned));
    let message = format!(
        "the results in `{}` are those of `{}`, which has the same name and profile",
        folder.display(),
        here.unwrap_or(other).display()
    );
    Err(Error::new(ErrorKind::Pipeline, message)
        .hint(format!(
            "give `{}` a `name` of its own, or its results a folder with `--out DIR`",
            file.display()
        ))
        .hint("or remove that folder, if the other file's results are not wanted"))
}

/// The way from the results folder to the pipeline file; `None` where one of them cannot be found.
fn source(folder: &Path, file: &Path) -> Option<String> {
    let (folder, file) = (fsx::real(folder)?, fsx::real(file)?);
    fsx::relative(&folder, &file).to_str().map(str::to_owned)
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
            let stem = stage.file_stem();
            let mut name = file_name(&stem, &format!(".{}", output.extension));
            for number in 1.. {
                // Two outputs of one ending, or names that differ only in characters that files should not have.
                if !wanted.contains_key(&name) {
                    break;
                }
                let more = if number == 1 { String::new() } else { format!("-{number}") };
                name = file_name(&stem, &format!("-{}{more}.{}", output.name, output.extension));
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

/// What is to be said of results before they are made: those whose names are too long for a file.
pub(super) fn cut_names(graph: &Graph) -> Vec<String> {
    let long: BTreeMap<&str, String> = graph
        .stages
        .node_weights()
        .map(|stage| (&*stage.id, stage.file_stem()))
        .filter(|(_, stem)| stem.len() > SURELY_SHORT)
        .collect();
    if long.is_empty() {
        return Vec::new();
    }
    let cut = wanted(graph, |_| None).into_iter().filter(|(name, (entry, _))| {
        long.get(entry.stage.as_str()).is_some_and(|stem| !name.starts_with(stem.as_str()))
    });
    cut.map(|(name, (entry, _))| {
        format!("the result of `{}` has a name too long for a file and goes to `{name}`", entry.stage)
    })
    .collect()
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
