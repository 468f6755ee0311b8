//! Lays the inputs of a stage out in its private folder, and checks afterwards that the program did not change them.
//!
//! A built-in stage reads blobs in place. An external program gets private copies: it may change permissions, and what it writes
//! must not reach any other stage. Writing to a copy is an error all the same, so that a pipeline behaves the same on every
//! file system.

use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicUsize, Ordering};
use std::sync::{Mutex, MutexGuard, PoisonError};

use super::apart;
use super::failure::Failure;
use crate::store::{Digest, PrivateCopy, Store, StoreError};

/// Copies per stage that are held open, so that a file that replaces a copy is not mistaken for it. The number is limited
/// because a process can have only so many open files.
const LARGEST: usize = 32;
/// All stages together hold at most this part of the files that this process may have open.
const PART: u64 = 4;

/// The copies that all stages hold open.
static HELD: AtomicUsize = AtomicUsize::new(0);

/// Changed files that an error names; of more, it gives the number.
const NAMED: usize = 5;

/// An input that is laid out in the stage's folder.
#[derive(Clone, Debug)]
pub(super) struct Placed {
    /// The input's name.
    pub port: &'static str,
    pub digest: Digest,
    pub to: PathBuf,
    pub is_folder: bool,
    pub executable: bool,
    /// True for a private copy, which an external program needs.
    pub private: bool,
}

/// The private copies of an input: its name, where it is, and its files.
type Copies = (&'static str, PathBuf, Vec<PrivateCopy>);

/// The inputs that were laid out.
#[derive(Debug, Default)]
pub struct LaidOut {
    copies: Mutex<Vec<Copies>>,
    /// How many of them are held open.
    held: usize,
}

impl LaidOut {
    /// Holds a copy open, if there is room for one more.
    fn hold(&mut self, copy: &mut PrivateCopy, most: usize) -> Result<(), Failure> {
        let one_more = |held: usize| (held < most).then_some(held + 1);
        if self.held >= LARGEST || HELD.fetch_update(Ordering::AcqRel, Ordering::Acquire, one_more).is_err() {
            return Ok(());
        }
        self.held += 1;
        Ok(copy.hold()?)
    }
}

impl Drop for LaidOut {
    fn drop(&mut self) {
        // The files first: others may be opened in their place as soon as they are not counted.
        self.copies().clear();
        HELD.fetch_sub(self.held, Ordering::AcqRel);
    }
}

/// Lays out every input.
pub(super) fn lay_out(placed: &[Placed], store: &Store) -> Result<LaidOut, Failure> {
    let mut laid = LaidOut::default();
    let most = usize::try_from(apart::open_files() / PART).unwrap_or(usize::MAX);
    for (number, input) in placed.iter().enumerate() {
        if number == 0
            && let Some(folder) = input.to.parent()
        {
            crate::fsx::create_dir_all(folder)?;
        }
        let mut copies = place(input, store).map_err(|error| match error {
            StoreError::Missing(_) | StoreError::Damaged(_) => {
                Failure::Input { port: input.port, source: error }
            }
            error => error.into(),
        })?;
        for copy in &mut copies {
            laid.hold(copy, most)?;
        }
        if !copies.is_empty() {
            laid.copies().push((input.port, input.to.clone(), copies));
        }
    }
    Ok(laid)
}

fn place(input: &Placed, store: &Store) -> Result<Vec<PrivateCopy>, StoreError> {
    match (input.private, input.is_folder) {
        (false, true) => store.lay_out(&input.digest, &input.to).map(|()| Vec::new()),
        (false, false) => Ok(Vec::new()),
        (true, true) => store.copy_out_folder(&input.digest, &input.to),
        (true, false) => Ok(vec![store.copy_out(&input.digest, &input.to, input.executable)?]),
    }
}

impl LaidOut {
    fn copies(&self) -> MutexGuard<'_, Vec<Copies>> {
        self.copies.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Accepts that the copies have got further names, as [`PrivateCopy::was_linked`].
    pub(super) fn were_linked(&self) -> Result<(), Failure> {
        let mut all = self.copies();
        Ok(all.iter_mut().flat_map(|(_, _, copies)| copies).try_for_each(PrivateCopy::was_linked)?)
    }

    /// Fails if the program changed an input: its outputs would then not follow from the pipeline file.
    pub(super) fn check(&self) -> Result<(), Failure> {
        let mut changed = Vec::new();
        for (port, root, copies) in self.copies().iter() {
            for copy in copies {
                if copy.was_changed()? {
                    changed.push(name(port, root, copy.path()));
                }
            }
        }
        if changed.is_empty() {
            return Ok(());
        }
        let more = changed.len().saturating_sub(NAMED);
        let more = if more > 0 { format!(" and {more} more") } else { String::new() };
        changed.truncate(NAMED);
        Err(Failure::ChangedInputs(format!("{}{more}", changed.join(", "))))
    }
}

/// The name of a file in an input, as in `demos/episode-1.npz`.
fn name(port: &str, root: &Path, path: &Path) -> String {
    match path.strip_prefix(root) {
        Ok(inside) if !inside.as_os_str().is_empty() => {
            format!("`{port}/{}`", inside.to_string_lossy().escape_debug())
        }
        _ => format!("`{port}`"),
    }
}
