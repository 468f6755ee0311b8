//! Hashes files and folders from outside. What has not changed since it was last hashed is not read again; the rest is read in
//! parallel.

use std::collections::{BTreeMap, BTreeSet};
use std::io;
use std::path::{Path, PathBuf};
use std::sync::Arc;

use globset::{GlobBuilder, GlobSetBuilder};
use rayon::prelude::*;

use super::{MissingFile, PlanError};
use crate::fsx::{self, FsError, Inside, Links, Outside, Stat, What};
use crate::resolve::{Graph, Origin};
use crate::store::{self, Digest, Folder, FolderEntry, FolderFile, Part, Stats, Store};

/// How often a file that changes while it is read is read again.
const TRIES: usize = 3;

/// Fewer bytes than this are read on one thread.
const SIDE_BY_SIDE: u64 = 1 << 20;

/// A file or folder from outside, as it was when the plan was made.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct OutsideFile {
    /// Where it is.
    pub path: PathBuf,
    /// The digest of its content; for a folder, of the list of its files.
    pub digest: Digest,
    /// Its size in bytes.
    pub bytes: u64,
    /// The files in it, for a folder.
    pub folder: Option<Arc<Folder>>,
    /// True for an executable file.
    pub executable: bool,
}

/// What the pipeline file states about a file from outside.
#[derive(Clone, Copy)]
struct Wanted<'g> {
    path: &'g str,
    /// See [`Origin::File`].
    key: &'g str,
    place: &'g str,
    folder: bool,
    blake3: Option<&'g str>,
    exclude: &'g [String],
}

/// The digest of each file, with its metadata.
type Contents = BTreeMap<PathBuf, (Digest, Stat)>;

/// What was found at a path.
enum Found {
    File(Stat),
    Folder(Vec<Inside>),
}

/// The digests of all files from outside of a graph, by their paths in the pipeline file.
///
/// # Errors
/// All files that cannot be read or do not match the pipeline file.
pub(super) fn outside_files(
    graph: &Graph,
    base: &Path,
    store: &Store,
) -> Result<(BTreeMap<String, OutsideFile>, Stats), PlanError> {
    let wanted = wanted(graph);
    if wanted.is_empty() {
        return Ok((BTreeMap::new(), Stats::default()));
    }
    let mut stats = store.stats();
    let mut missing = Vec::new();
    let mut looked: BTreeMap<&str, (PathBuf, Found)> = BTreeMap::new();
    for one in &wanted {
        if looked.contains_key(one.key) {
            continue;
        }
        let path = base.join(one.path);
        match look(&path, one.folder, one.exclude) {
            Ok(found) => drop(looked.insert(one.key, (path, found))),
            Err(source) => missing.push(MissingFile { place: one.place.to_owned(), source }),
        }
    }
    let digests = match digests(&looked, &mut stats) {
        Ok(digests) => digests,
        Err(errors) => {
            missing.extend(errors.into_iter().map(|(written, source)| {
                let place = wanted.iter().find(|one| one.key == written).map_or("", |one| one.place);
                MissingFile { place: place.to_owned(), source }
            }));
            return Err(PlanError::Files(missing));
        }
    };
    let mut files = BTreeMap::new();
    for (written, (path, found)) in looked {
        files.insert(written.to_owned(), outside_file(path, found, &digests));
    }
    missing.extend(wanted.iter().filter_map(|one| differs(one, files.get(one.key)?)));
    if missing.is_empty() { Ok((files, stats)) } else { Err(PlanError::Files(missing)) }
}

fn wanted(graph: &Graph) -> Vec<Wanted<'_>> {
    let wires = graph.stages.node_weights().flat_map(|stage| &stage.inputs);
    let sources = wires.flat_map(|wire| &wire.sources);
    let mut seen = BTreeSet::new();
    let wanted = sources.filter_map(|source| match &source.from {
        Origin::File { path, place, folder, blake3, exclude, key } => {
            Some(Wanted { path, key, place, folder: *folder, blake3: blake3.as_deref(), exclude })
        }
        Origin::Stage { .. } => None,
    });
    wanted.filter(|one| seen.insert((one.key, one.folder, one.blake3))).collect()
}

fn look(path: &Path, folder: bool, exclude: &[String]) -> fsx::Result<Found> {
    let refuse = |why: &'static str| Err(FsError::at("read", path)(io::Error::other(why)));
    match (fsx::outside(path)?, folder) {
        (Outside::File(stat), false) => Ok(Found::File(stat)),
        (Outside::Folder, true) => Ok(Found::Folder(inside(path, exclude)?)),
        (Outside::Folder, false) => refuse("it is a folder, expected a file"),
        (Outside::File(_), true) => refuse("it is a file, expected a folder"),
    }
}

/// The contents of a folder from outside, without what the globs `exclude` match.
///
/// # Errors
/// Something in it cannot be read, or is neither file nor folder.
pub fn inside(folder: &Path, exclude: &[String]) -> fsx::Result<Vec<Inside>> {
    let mut globs = GlobSetBuilder::new();
    for glob in exclude {
        // A glob without `/` matches at any depth, a path from the folder on.
        let glob = glob.strip_suffix('/').unwrap_or(glob);
        let anywhere = if glob.contains('/') { "" } else { "**/" };
        let glob = format!("{anywhere}{}", glob.strip_prefix('/').unwrap_or(glob));
        // Invalid globs were reported when the pipeline was read.
        if let Ok(glob) = GlobBuilder::new(&glob).literal_separator(true).build() {
            globs.add(glob);
        }
    }
    let globs = globs.build().unwrap_or_default();
    fsx::walk(folder, Links::Follow, &|inside| globs.is_match(inside))
}

/// The digest of every file; unknown ones are read.
fn digests<'w>(
    looked: &BTreeMap<&'w str, (PathBuf, Found)>,
    stats: &mut Stats,
) -> Result<Contents, Vec<(&'w str, FsError)>> {
    let mut known = BTreeMap::new();
    let (mut unknown, mut bytes) = (Vec::new(), 0_u64);
    for (written, (path, found)) in looked {
        let files: Vec<(PathBuf, Stat)> = match found {
            Found::File(stat) => vec![(path.clone(), *stat)],
            Found::Folder(inside) => {
                let file = |inside: &Inside| match inside.what {
                    What::File(stat) => Some((path.join(&inside.path), stat)),
                    What::Empty | What::Link(_) => None,
                };
                inside.iter().filter_map(file).collect()
            }
        };
        for (path, stat) in files {
            match stats.digest(&fsx::absolute(&path), &stat) {
                Some(digest) => drop(known.insert(path, (digest, stat))),
                None => {
                    bytes = bytes.saturating_add(stat.bytes);
                    unknown.push((*written, path));
                }
            }
        }
    }
    let one = |(written, path): &'_ (&'w str, PathBuf)| (*written, path.clone(), read(path));
    // For little data, threads cost more than they gain.
    let read: Vec<_> = if bytes < SIDE_BY_SIDE {
        unknown.iter().map(one).collect()
    } else {
        unknown.par_iter().map(one).collect()
    };
    let mut errors = Vec::new();
    for (written, path, result) in read {
        match result {
            Ok(Read { digest, stat, began, steady }) => {
                if steady {
                    stats.learn(&fsx::absolute(&path), stat, began, digest);
                }
                known.insert(path, (digest, stat));
            }
            Err(error) => errors.push((written, error)),
        }
    }
    if errors.is_empty() { Ok(known) } else { Err(errors) }
}

struct Read {
    digest: Digest,
    stat: Stat,
    began: i64,
    /// True where the file did not change while it was read.
    steady: bool,
}

fn read(path: &Path) -> fsx::Result<Read> {
    let mut tries = 0;
    loop {
        tries += 1;
        let began = store::now();
        let Outside::File(before) = fsx::outside(path)? else {
            return Err(FsError::at("read", path)(io::Error::other("it is no longer a file")));
        };
        let (digest, _) = store::hash_file(path)?;
        let steady = fsx::outside(path)? == Outside::File(before);
        if steady || tries == TRIES {
            return Ok(Read { digest, stat: before, began, steady });
        }
    }
}

fn outside_file(path: PathBuf, found: Found, digests: &Contents) -> OutsideFile {
    let of = |path: &Path| digests.get(path).copied();
    match found {
        Found::File(stat) => {
            let (digest, stat) = of(&path).unwrap_or((Digest::of(&[]), stat));
            OutsideFile { path, digest, bytes: stat.bytes, folder: None, executable: stat.executable }
        }
        Found::Folder(inside) => {
            let entries = inside.into_iter().map(|inside| {
                let what = match inside.what {
                    What::File(stat) => {
                        let (digest, stat) = of(&path.join(&inside.path)).unwrap_or((Digest::of(&[]), stat));
                        let (bytes, executable) = (stat.bytes, stat.executable);
                        Part::File(FolderFile { digest, bytes, executable })
                    }
                    What::Empty => Part::Empty,
                    What::Link(to) => Part::Link(to),
                };
                FolderEntry { path: inside.path, what }
            });
            let folder = Folder::new(entries.collect());
            let list = folder.to_bytes();
            let (digest, bytes) = (Digest::of(&list), list.len() as u64);
            OutsideFile { path, digest, bytes, folder: Some(Arc::new(folder)), executable: false }
        }
    }
}

/// A file does not match the pipeline file.
fn differs(wanted: &Wanted<'_>, found: &OutsideFile) -> Option<MissingFile> {
    let expected = wanted.blake3.filter(|expected| **expected != found.digest.hex())?;
    let why = format!("its content is {}, expected {expected}", found.digest);
    let source = FsError::at("use", &found.path)(io::Error::other(why));
    Some(MissingFile { place: wanted.place.to_owned(), source })
}
