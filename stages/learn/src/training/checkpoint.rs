//! Checkpoints: the whole state of a long stage in one file, from which it resumes bit-identically.
//!
//! The state is a small serialisable value (counters, random streams, log rows) and named arrays (weights, moments,
//! frames, environments). The file is written under a temporary name and renamed, so that a crash leaves the old one. It
//! starts with its digest, so that a truncated or damaged file is recognised, and the stage restarts.

use std::collections::BTreeMap;
use std::io::Write;
use std::path::Path;

use dril_stage_api::StageError;
use serde::{Serialize, de::DeserializeOwned};

/// The first bytes of a checkpoint. The version is raised when the layout changes; the states of the stages change with
/// their revisions, and a checkpoint folder belongs to one.
const MAGIC: &[u8; 20] = b"dril-checkpoint-v1\n\0";
const FILE: &str = "state";

/// Named arrays of a checkpoint.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Arrays(BTreeMap<String, Vec<u8>>);

impl Arrays {
    /// No arrays.
    pub fn new() -> Self {
        Self::default()
    }

    /// Adds bytes.
    pub fn put(&mut self, name: &str, bytes: impl Into<Vec<u8>>) {
        self.0.insert(name.to_owned(), bytes.into());
    }

    /// Adds numbers.
    pub fn put_f32(&mut self, name: &str, values: &[f32]) {
        self.put(name, values.iter().flat_map(|value| value.to_le_bytes()).collect::<Vec<u8>>());
    }

    /// Removes and returns bytes.
    ///
    /// # Errors
    /// There is no array of that name.
    pub fn take(&mut self, name: &str) -> Result<Vec<u8>, StageError> {
        self.0.remove(name).ok_or_else(|| foreign(&format!("it has no `{name}`")))
    }

    /// Removes and returns numbers.
    ///
    /// # Errors
    /// There is no array of that name, or its length is not `len`.
    pub fn take_f32(&mut self, name: &str, len: usize) -> Result<Vec<f32>, StageError> {
        let bytes = self.take(name)?;
        if bytes.len() != 4 * len {
            return Err(foreign(&format!("`{name}` has {} bytes, expected {}", bytes.len(), 4 * len)));
        }
        Ok(bytes.chunks_exact(4).map(|b| f32::from_le_bytes([b[0], b[1], b[2], b[3]])).collect())
    }
}

/// The error for an intact checkpoint that is not from this stage.
pub fn foreign(what: &str) -> StageError {
    StageError::failed(format!(
        "the checkpoint is of another program version: {what}; empty the checkpoint folder to start again"
    ))
}

/// Writes the checkpoint of this stage, replacing the last one.
///
/// # Errors
/// The folder cannot be written to.
pub fn save<S: Serialize>(folder: &Path, state: &S, arrays: &Arrays) -> Result<(), StageError> {
    let body = encode(state, arrays)?;
    let temporary = folder.join("state.new");
    let mut file = std::fs::File::create(&temporary).map_err(StageError::io("cannot write", &temporary))?;
    file.write_all(MAGIC)
        .and_then(|()| file.write_all(blake3::hash(&body).as_bytes()))
        .and_then(|()| file.write_all(&body))
        .and_then(|()| file.sync_all())
        .map_err(StageError::io("cannot write", &temporary))?;
    let path = folder.join(FILE);
    std::fs::rename(&temporary, &path).map_err(StageError::io("cannot rename to", &path))
}

/// Reads the checkpoint of this stage; `None` if there is none, or if it is truncated or damaged.
///
/// # Errors
/// The file cannot be read, or is intact but from another stage (see [`foreign`]).
pub fn load<S: DeserializeOwned>(folder: &Path) -> Result<Option<(S, Arrays)>, StageError> {
    let path = folder.join(FILE);
    let bytes = match std::fs::read(&path) {
        Ok(bytes) => bytes,
        Err(error) if error.kind() == std::io::ErrorKind::NotFound => return Ok(None),
        Err(error) => return Err(StageError::io("cannot read", &path)(error)),
    };
    let Some((head, body)) = bytes.split_at_checked(MAGIC.len() + blake3::OUT_LEN) else { return Ok(None) };
    let (magic, digest) = head.split_at(MAGIC.len());
    if magic != MAGIC || digest != blake3::hash(body).as_bytes() {
        return Ok(None);
    }
    decode(body).map(Some)
}

/// Length-prefixed: the state as JSON, then name and bytes of each array.
fn encode<S: Serialize>(state: &S, arrays: &Arrays) -> Result<Vec<u8>, StageError> {
    let mut body = Vec::new();
    let mut put = |bytes: &[u8]| {
        body.extend((bytes.len() as u64).to_le_bytes());
        body.extend(bytes);
    };
    put(&serde_json::to_vec(state).map_err(StageError::failed)?);
    for (name, bytes) in &arrays.0 {
        put(name.as_bytes());
        put(bytes);
    }
    Ok(body)
}

fn decode<S: DeserializeOwned>(mut body: &[u8]) -> Result<(S, Arrays), StageError> {
    let state = take_part(&mut body).ok_or_else(|| foreign("it has no state"))?;
    let state = serde_json::from_slice(state).map_err(|error| foreign(&error.to_string()))?;
    let mut arrays = Arrays::new();
    while let Some(name) = take_part(&mut body) {
        let bytes = take_part(&mut body).ok_or_else(|| foreign("an array has no content"))?;
        arrays.put(&String::from_utf8_lossy(name), bytes);
    }
    Ok((state, arrays))
}

fn take_part<'a>(body: &mut &'a [u8]) -> Option<&'a [u8]> {
    let (length, rest) = body.split_first_chunk::<8>()?;
    let (part, rest) = rest.split_at_checked(usize::try_from(u64::from_le_bytes(*length)).ok()?)?;
    *body = rest;
    Some(part)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn sample() -> Arrays {
        let mut arrays = Arrays::new();
        arrays.put_f32("weights", &[1.5, -0.0, f32::MIN_POSITIVE]);
        arrays.put("environment 0", vec![7; 100]);
        arrays.put("nothing", vec![]);
        arrays
    }

    #[test]
    fn a_checkpoint_comes_back_as_it_was_saved_and_replaces_the_one_before() {
        let folder = tempfile::tempdir().unwrap();
        save(folder.path(), &1_u32, &Arrays::new()).unwrap();
        save(folder.path(), &(5_u32, "x"), &sample()).unwrap();
        let (state, mut arrays) = load::<(u32, String)>(folder.path()).unwrap().unwrap();
        assert_eq!((state.0, state.1.as_str()), (5, "x"));
        assert_eq!(arrays, sample());
        assert_eq!(arrays.take_f32("weights", 3).unwrap()[0], 1.5);
        assert!(arrays.take_f32("weights", 3).is_err());
    }

    #[test]
    fn a_missing_a_cut_off_and_a_damaged_checkpoint_mean_a_new_start() {
        let folder = tempfile::tempdir().unwrap();
        assert!(load::<u32>(folder.path()).unwrap().is_none());
        save(folder.path(), &5_u32, &sample()).unwrap();
        let path = folder.path().join(FILE);
        let whole = std::fs::read(&path).unwrap();
        for length in 0..whole.len() {
            std::fs::write(&path, &whole[..length]).unwrap();
            assert!(load::<u32>(folder.path()).unwrap().is_none(), "cut to {length}");
        }
        for place in 0..whole.len() {
            let mut damaged = whole.clone();
            damaged[place] ^= 1;
            std::fs::write(&path, &damaged).unwrap();
            assert!(load::<u32>(folder.path()).unwrap().is_none(), "bit flipped at {place}");
        }
    }

    #[test]
    fn a_whole_checkpoint_of_something_else_is_an_error_that_says_so() {
        let folder = tempfile::tempdir().unwrap();
        save(folder.path(), &"text", &Arrays::new()).unwrap();
        let message = load::<u32>(folder.path()).unwrap_err().to_string();
        assert!(message.contains("another program version"), "{message}");
    }
}
