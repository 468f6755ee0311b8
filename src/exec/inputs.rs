//! The inputs of a stage in its private folder, and whether the program that read them left them alone.
//!
//! A stage of our own kinds reads contents where they lie in the store. A program is given copies of its own: it may take
//! any right for itself, and what it writes must reach nobody else. That it wrote is an error all the same, wherever the
//! copy was, so that a pipeline means the same on every file system.

use std::path::{Path, PathBuf};

use super::work::Failure;
use crate::store::{Digest, PrivateCopy, Store, StoreError};

/// So many copies of a stage are held open, so that a file which takes the place of one is not taken for it. A process may
/// have about a thousand files open.
const HELD: usize = 32;

/// More names than this are not listed.
const NAMED: usize = 5;

/// An input that is put into the stage's folder.
#[derive(Clone, Debug)]
pub(super) struct Placed {
    /// The input's name.
    pub port: &'static str,
    pub digest: Digest,
    pub to: PathBuf,
    pub is_folder: bool,
    pub executable: bool,
    /// True for a copy of its own, which a program needs.
    pub private: bool,
}

/// What was laid out.
#[derive(Debug, Default)]
pub(super) struct LaidOut {
    copies: Vec<(&'static str, PathBuf, Vec<PrivateCopy>)>,
}

/// Puts every input into its place.
pub(super) fn lay_out(placed: &[Placed], store: &Store) -> Result<LaidOut, Failure> {
    let mut laid = LaidOut::default();
    let mut held = 0;
    for (number, input) in placed.iter().enumerate() {
        if number == 0
            && let Some(folder) = input.to.parent()
        {
            crate::fsx::create_dir_all(folder)?;
        }
        let mut copies = place(input, store).map_err(|error| match error {
            StoreError::Missing(_) | StoreError::Damaged(_) => {
                Failure::of_store(format!("input `{}` cannot be read: {error}", input.port))
            }
            error => error.into(),
        })?;
        for copy in copies.iter_mut().take(HELD.saturating_sub(held)) {
            copy.hold()?;
            held += 1;
        }
        if !copies.is_empty() {
            laid.copies.push((input.port, input.to.clone(), copies));
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
    /// Finds out that the program wrote into an input: what it made then is no result of what the pipeline says.
    pub fn check(&self) -> Result<(), Failure> {
        let mut changed = Vec::new();
        for (port, root, copies) in &self.copies {
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
        Err(Failure::by_itself(format!(
            "the command changed its input {}{more}: inputs are read-only; only this stage's own copy was changed, and no \
             other stage sees it. Let the command work on a copy of its own",
            changed.join(", ")
        )))
    }
}

/// The name of a file in an input, as the program knows it.
fn name(port: &str, root: &Path, path: &Path) -> String {
    match path.strip_prefix(root) {
        Ok(inside) if !inside.as_os_str().is_empty() => {
            format!("`{port}/{}`", inside.to_string_lossy().escape_debug())
        }
        _ => format!("`{port}`"),
    }
}
