//! What a run does with the lock file beside the pipeline: compare with it, or write it.

use std::path::PathBuf;

use super::lockfile::{self, Keys, LockFile};
use super::source::PipelineSource;
use crate::error::{Error, ErrorKind};
use crate::exec::Executed;
use crate::fsx;
use crate::plan::Plan;
use crate::resolve::Graph;

/// What a run does with the lock file.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum LockMode {
    /// Updates the lock file if there is one and nothing is overridden.
    #[default]
    Update,
    /// Writes it (`--lock`).
    Write,
    /// Fails where the plan or the results differ from it (`--locked`).
    Check,
}

/// A lock file that a run wrote, because its results differ from what was in it.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Rewritten {
    /// The file.
    pub path: PathBuf,
    /// The number of lines that are new, different or gone.
    pub lines: usize,
}

/// The lock file of a run.
pub(super) struct Locking {
    path: PathBuf,
    old: Option<LockFile>,
    must_match: bool,
    write: bool,
    /// `--lock`: it will be written. Otherwise only where a result differs.
    is_asked_for: bool,
}

impl Locking {
    /// Reads the lock file.
    ///
    /// # Errors
    /// It is damaged, or it is missing and must match.
    pub fn read(source: &PipelineSource, mode: LockMode) -> Result<Self, Error> {
        let path = lockfile::path_of(&source.file);
        let old = LockFile::read(&path)?;
        let must_match = mode == LockMode::Check;
        if must_match && old.is_none() {
            let text = format!("there is no lock file `{}`", path.display());
            return Err(Error::new(ErrorKind::Check, text).hint("`dril-pipe run --lock` writes one"));
        }
        let unchanged = source.choices.set.is_empty();
        let write = mode == LockMode::Write || mode == LockMode::Update && old.is_some() && unchanged;
        Ok(Self { path, old, must_match, write, is_asked_for: mode == LockMode::Write })
    }

    /// Fails where the plan already differs from a lock file that must match.
    pub fn check_plan(&self, plan: &Plan<'_>) -> Result<(), Error> {
        match self.old.as_ref().filter(|_| self.must_match).map(|lock| lock.against_plan(plan)) {
            Some(found) if !found.is_empty() => Err(lockfile::differs(&self.path, found)),
            _ => Ok(()),
        }
    }

    /// Fails where a run that executes something will have to write the lock file and cannot.
    pub fn check_place(&self, will_run: bool) -> Result<(), Error> {
        let folder = self.path.parent().filter(|_| self.is_asked_for && will_run);
        folder.map_or(Ok(()), fsx::can_be_written).map_err(|error| {
            Error::new(
                ErrorKind::Io,
                format!("cannot write the lock file `{}`: {error}", self.path.display()),
            )
            .hint("nothing was run; make the folder of the pipeline file writable, or run without `--lock`")
        })
    }

    /// Compares the results with the lock file, or writes them to it. Returns how many lines changed, if any.
    pub fn check_or_write(&self, graph: &Graph, executed: &Executed) -> Result<Option<Rewritten>, Error> {
        let keys: Keys = graph
            .stages
            .node_indices()
            .zip(&executed.keys)
            .filter_map(|(stage, key)| Some((stage, (*key)?)))
            .collect();
        if let Some(lock) = self.old.as_ref().filter(|_| self.must_match) {
            let found = lock.against_results(graph, &keys, executed);
            if !found.is_empty() {
                return Err(lockfile::differs(&self.path, found));
            }
        }
        if self.write {
            let mut lock = self.old.clone().unwrap_or_default();
            lock.update(graph, &keys, executed, executed.outcome.is_complete());
            if self.old.as_ref() != Some(&lock) {
                fsx::write_atomic(&self.path, lock.text().as_bytes())?;
                let lines = lock.changed_since(self.old.as_ref());
                return Ok(Some(Rewritten { path: self.path.clone(), lines }));
            }
        }
        Ok(None)
    }
}
