//! Copies tables and figures from the store to the results folder, and removes results that a changed pipeline no longer has.
//! A manifest in the folder lists the files that we wrote; no other file is touched.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

use serde::{Deserialize, Serialize};

use crate::error::{Error, ErrorKind};
use crate::fsx;
use crate::resolve::Graph;
use crate::store::{Digest, Outputs, Store, Stored};

/// The file name of the manifest.
const MANIFEST: &str = ".dril-pipe.json";
/// The version of the manifest's format.
const MANIFEST_VERSION: u32 = 1;

/// A stem of this many bytes fits into a file name together with an output's name and extension.
const SHORT_STEM: usize = 120;

/// The files in the results folder, and the pipeline that made them.
#[derive(Debug, Clone, Default, PartialEq, Eq, Serialize, Deserialize)]
struct Manifest {
    version: u32,
    pipeline: String,
    profile: String,
    /// The pipeline file, relative to this folder; missing in old manifests.
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

/// What was copied to the results folder.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub struct Published {
    /// The results folder.
    pub folder: PathBuf,
    /// Number of files there that this pipeline made.
    pub files: usize,
    /// Files from an earlier run, because their stage did not finish in this one.
    pub earlier: Vec<String>,
    /// Files that were removed because the pipeline no longer makes them.
    pub removed: Vec<String>,
}

/// Where results go by default: `results/<pipeline>-<profile>`.
pub fn default_folder(graph: &Graph) -> PathBuf {
    Path::new("results").join(format!("{}-{}", graph.pipeline, graph.profile))
}

/// Brings the folder up to date with the outputs of the finished stages; `None` where there are no results and there were
/// none.
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
    let wanted = wanted(graph, outputs);
    // Without results, it does not matter what is there.
    let old = match read_manifest(folder) {
        Err(_) if wanted.is_empty() => Manifest::default(),
        old => old?,
    };
    if wanted.values().all(|(_, stored)| stored.is_none()) && old.files.is_empty() {
        return Ok(None);
    }
    fsx::create_dir_all(folder)?;
    let mut manifest = Manifest {
        version: MANIFEST_VERSION,
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
            manifest.files.insert(name, Entry { digest: stored.digest, ..entry });
        } else if let Some(entry) = old.files.get(&name) {
            manifest.files.insert(name.clone(), entry.clone());
            published.earlier.push(name);
        }
    }
    published.files = manifest.files.len();
    // Results of another profile stay: that profile still makes them.
    if old.profile == manifest.profile {
        published.removed = remove_stale(folder, &old, &manifest)?;
    }
    if manifest != old {
        fsx::write_atomic(&folder.join(MANIFEST), to_json(&manifest).as_bytes())?;
    }
    Ok(Some(published))
}

/// Refuses a folder with the results of another pipeline file: two files with the same `name` would remove each other's
/// results. A file that no longer exists does not count, nor does the same file under another name.
///
/// # Errors
/// The folder belongs to another pipeline file.
pub(super) fn check_owner(folder: &Path, file: &Path, graph: &Graph) -> Result<(), Error> {
    // An unreadable folder is reported by `check_place`.
    let manifest = read_manifest(folder).unwrap_or_default();
    let Some(other) =
        manifest.source.filter(|_| !manifest.files.is_empty()).map(|source| folder.join(source))
    else {
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
        "`{}` contains the results of `{}`, which has the same name and profile",
        folder.display(),
        here.unwrap_or(other).display()
    );
    Err(Error::new(ErrorKind::Pipeline, message)
        .hint(format!(
            "give `{}` another `name`, or choose another results folder with `--out DIR`",
            file.display()
        ))
        .hint("or remove that folder if you do not need the other results"))
}

/// Refuses a folder that results cannot be copied to, and creates nothing. `will_write` is true where something will run: then the
/// folder must be writable. Where nothing runs, all results may be in place.
///
/// # Errors
/// Something is in the way, or the folder cannot be written.
pub(super) fn check_place(folder: &Path, graph: &Graph, will_write: bool) -> Result<(), Error> {
    let names = file_names(graph);
    if names.is_empty() {
        return Ok(());
    }
    let what = format!("to the results folder `{}`", folder.display());
    let place = if will_write { fsx::can_be_written(folder) } else { fsx::can_be_folder(folder) };
    place.map_err(|error| unwritable(&what, "--out", folder, &error))?;
    let mut problems = Vec::new();
    for name in names.values().map(String::as_str).chain([MANIFEST]) {
        let path = folder.join(name);
        if fsx::entry(&path)? == Some(fsx::Entry::Folder) {
            problems.push(format!("`{}` is a folder, expected a file", path.display()));
        }
    }
    if problems.is_empty() { Ok(()) } else { Err(refused(&what, "--out", &problems.join("; "), IN_THE_WAY)) }
}

/// Refuses a folder in which stages that will run cannot write learning curves.
///
/// # Errors
/// Something is in the way, or the folder cannot be written.
pub(super) fn check_curves(folder: &Path) -> Result<(), Error> {
    let what = format!("learning curves to `{}`", folder.display());
    fsx::can_be_written(folder).map_err(|error| unwritable(&what, "--tensorboard", folder, &error))
}

const IN_THE_WAY: &str = "move what is in the way";

fn unwritable(what: &str, option: &str, folder: &Path, error: &fsx::FsError) -> Error {
    let seen = error.source.to_string();
    match error.source.kind() {
        std::io::ErrorKind::NotADirectory if error.path == folder => refused(what, option, &seen, IN_THE_WAY),
        std::io::ErrorKind::NotADirectory => {
            let seen = seen.strip_prefix("it ").unwrap_or(&seen);
            refused(what, option, &format!("`{}` {seen}", error.path.display()), IN_THE_WAY)
        }
        _ => refused(what, option, &error.to_string(), "make it writable"),
    }
}

fn refused(what: &str, option: &str, seen: &str, remedy: &str) -> Error {
    Error::new(ErrorKind::Io, format!("cannot write {what}: {seen}"))
        .hint(format!("nothing was run; {remedy}, or choose another folder with `{option} DIR`"))
}

/// The path of the pipeline file relative to the results folder; `None` where one of them cannot be found.
fn source(folder: &Path, file: &Path) -> Option<String> {
    let (folder, file) = (fsx::real(folder)?, fsx::real(file)?);
    fsx::relative(&folder, &file).to_str().map(str::to_owned)
}

/// True where the folder has this many results, each as listed in the manifest.
///
/// # Errors
/// The folder cannot be read.
pub(super) fn are_whole(folder: &Path, files: usize) -> Result<bool, Error> {
    let manifest = read_manifest(folder)?;
    for (name, entry) in &manifest.files {
        if !holds(&folder.join(name), &entry.digest)? {
            return Ok(false);
        }
    }
    Ok(manifest.files.len() == files)
}

/// The file names of a graph's results, by stage and output.
pub fn file_names(graph: &Graph) -> BTreeMap<(String, String), String> {
    let wanted = wanted(graph, |_| None).into_iter();
    wanted.map(|(name, (entry, _))| ((entry.stage, entry.output), name)).collect()
}

/// The results of a graph by file name, with the stored output where the stage is done.
fn wanted<'a>(
    graph: &Graph,
    outputs: impl Fn(crate::resolve::StageIndex) -> Option<&'a Outputs>,
) -> BTreeMap<String, (Entry, Option<&'a Stored>)> {
    let mut wanted = BTreeMap::new();
    for index in graph.stages.node_indices() {
        let stage = &graph.stages[index];
        for (output, name) in stage.result_files() {
            let stored = outputs(index).and_then(|outputs| outputs.get(output.name));
            // For an unfinished stage the digest is a placeholder and never used.
            let digest = stored.map_or_else(|| Digest::of(&[]), |stored| stored.digest);
            let entry = Entry { stage: stage.id.to_string(), output: output.name.to_owned(), digest };
            wanted.insert(name, (entry, stored));
        }
    }
    wanted
}

/// A note for each result whose name is too long for a file, for the plan to show.
pub fn cut_names(graph: &Graph) -> Vec<String> {
    let long: BTreeMap<&str, String> = graph
        .stages
        .node_weights()
        .map(|stage| (&*stage.id, stage.file_stem()))
        .filter(|(_, stem)| stem.len() > SHORT_STEM)
        .collect();
    if long.is_empty() {
        return Vec::new();
    }
    let cut = wanted(graph, |_| None).into_iter().filter(|(name, (entry, _))| {
        long.get(entry.stage.as_str()).is_some_and(|stem| !name.starts_with(stem.as_str()))
    });
    cut.map(|(name, (entry, _))| {
        format!(
            "the name of the result of `{}` is too long for a file; it is written to `{name}`",
            entry.stage
        )
    })
    .collect()
}

/// True where the file has this content.
fn holds(path: &Path, digest: &Digest) -> Result<bool, Error> {
    match fsx::entry(path)? {
        Some(fsx::Entry::File(_)) => {
            let bytes = fsx::read_if_there(path)?;
            Ok(bytes.is_some_and(|bytes| Digest::of(&bytes) == *digest))
        }
        _ => Ok(false),
    }
}

/// Removes the files that are in the old manifest and not in the new one, unless their content was changed.
fn remove_stale(folder: &Path, old: &Manifest, new: &Manifest) -> Result<Vec<String>, Error> {
    let mut removed = Vec::new();
    for (name, entry) in old.files.iter().filter(|(name, _)| !new.files.contains_key(*name)) {
        // Anybody can edit the manifest: it must not name files outside its folder.
        let is_plain_name = Path::new(name).file_name().is_some_and(|file| file == name.as_str());
        let path = folder.join(name);
        if is_plain_name && holds(&path, &entry.digest)? && fsx::remove_file(&path)? {
            removed.push(name.clone());
        }
    }
    Ok(removed)
}

/// The manifest of a folder; an empty one where there is none or it cannot be parsed.
fn read_manifest(folder: &Path) -> Result<Manifest, Error> {
    let bytes = fsx::read_if_there(&folder.join(MANIFEST))?;
    let manifest = bytes.and_then(|bytes| serde_json::from_slice::<Manifest>(&bytes).ok());
    Ok(manifest.filter(|manifest| manifest.version == MANIFEST_VERSION).unwrap_or_default())
}

fn to_json(manifest: &Manifest) -> String {
    // Only strings, numbers and maps with string keys: this cannot fail.
    serde_json::to_string_pretty(manifest).map(|text| text + "\n").unwrap_or_default()
}
