//! From a stage's private folder to the store: checks that every declared output was written, takes the files as blobs,
//! and writes the record last.

use std::path::{Path, PathBuf};

use dril_stage_api::{Artifact, Output, Ports};

use super::failure::Failure;
use crate::fsx::{self, Entry};
use crate::plan::OutsideFile;
use crate::store::{Blob, Key, Outputs, Record, Run, Store, StoreError, Stored};

/// Where a stage writes an output.
pub(super) fn output_path(folder: &Path, name: &str, extension: &str) -> PathBuf {
    let ending = if extension.is_empty() { "" } else { "." };
    folder.join(format!("output-{name}{ending}{extension}"))
}

/// Checks that an output was written and is of the declared type.
pub(super) fn check_output(output: &Output, path: &Path) -> Result<(), Failure> {
    let expected = if output.artifact == Artifact::FOLDER { "folder" } else { "file" };
    let seen = match fsx::entry(path)? {
        Some(Entry::File(_)) if expected == "file" => return Ok(()),
        Some(Entry::Folder) if expected == "folder" => return Ok(()),
        None => return Err(Failure::MissingOutput(output.name.to_owned())),
        Some(Entry::File(_)) => "is a file",
        Some(Entry::Folder) => "is a folder",
        Some(Entry::Other) => "is a link or not a regular file",
    };
    Err(Failure::WrongOutput { output: output.name.to_owned(), seen, expected })
}

/// Moves the outputs of a stage into the store, all of them or none.
pub(super) fn take_outputs(
    ports: &Ports,
    folder: &Path,
    store: &Store,
    run: &Run,
) -> Result<(Outputs, Vec<Blob>), Failure> {
    let mut paths = Vec::with_capacity(ports.outputs.len());
    for output in &ports.outputs {
        let path = output_path(folder, output.name, output.extension);
        check_output(output, &path)?;
        paths.push(path);
    }
    let mut outputs = Outputs::new();
    let mut blobs = Vec::with_capacity(paths.len());
    for (output, path) in ports.outputs.iter().zip(paths) {
        let folder = output.artifact == Artifact::FOLDER;
        let executable = !folder && fsx::is_executable(&path)?;
        let blob = if folder { store.take_folder_for(&path, run)? } else { store.take_for(&path, run)? };
        let (digest, bytes, extension) = (blob.digest, blob.bytes, output.extension.to_owned());
        let stored = Stored { digest, bytes, extension, folder, executable };
        outputs.insert(output.name.to_owned(), stored);
        blobs.push(blob);
    }
    Ok((outputs, blobs))
}

/// The outputs of a stage that only brings files in from outside: the files as they are.
pub(super) fn outside_as_outputs(files: &[&OutsideFile], ports: &Ports) -> Outputs {
    let stored = |file: &OutsideFile, output: &Output| Stored {
        digest: file.digest,
        bytes: file.bytes,
        extension: output.extension.to_owned(),
        folder: file.folder.is_some(),
        executable: file.executable,
    };
    let pairs = files.iter().zip(&ports.outputs);
    pairs.map(|(file, output)| (output.name.to_owned(), stored(file, output))).collect()
}

/// Copies a file or folder from outside into the store.
pub(super) fn import(file: &OutsideFile, store: &Store, run: &Run) -> Result<(), StoreError> {
    match &file.folder {
        Some(folder) => store.import_folder(&file.path, folder, run),
        None => store.import(&file.path, &file.digest, run),
    }
}

/// Makes the blobs durable, then the record; then the checkpoints are no longer needed.
pub(super) fn commit(
    store: &Store,
    key: &Key,
    record: &Record,
    blobs: &[Blob],
    folder: &Path,
) -> Result<(), StoreError> {
    store.commit(key, record, blobs, folder)?;
    store.clear_checkpoints(key, folder)
}
