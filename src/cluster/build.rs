//! The builds of the programs that run a stage: engine and node may find different ones under the same path, since a program can be
//! built again while jobs wait, and nodes can have copies of their own.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use std::sync::{Mutex, PoisonError};

use crate::store;

/// Programs by file name, each with the digest of its content.
pub(super) type Build = BTreeMap<String, String>;

/// Digests that were computed in this process: a program takes some hundredths of a second.
static KNOWN: Mutex<BTreeMap<PathBuf, Option<String>>> = Mutex::new(BTreeMap::new());

/// The build of `program` and of the worker beside it. A program that cannot be read is left out: it is reported where it is started.
pub(super) fn of(program: &Path, worker: Option<&str>) -> Build {
    let worker =
        worker.map(|worker| program.with_file_name(format!("{worker}{}", std::env::consts::EXE_SUFFIX)));
    let programs = std::iter::once(program.to_owned()).chain(worker);
    programs.filter_map(|path| Some((name(&path)?, digest(&path)?))).collect()
}

/// The first program that is another build here than in `expected`.
pub(super) fn differing<'e>(expected: &'e Build, here: &Build) -> Option<&'e str> {
    let differs =
        |(name, digest): &(&'e String, &String)| here.get(*name).is_some_and(|here| here != *digest);
    expected.iter().find(differs).map(|(name, _)| name.as_str())
}

fn name(path: &Path) -> Option<String> {
    Some(path.file_name()?.to_str()?.to_owned())
}

fn digest(path: &Path) -> Option<String> {
    let mut known = KNOWN.lock().unwrap_or_else(PoisonError::into_inner);
    let hash = || store::hash_file(path).ok().map(|(digest, _)| digest.hex());
    known.entry(path.to_owned()).or_insert_with(hash).clone()
}
