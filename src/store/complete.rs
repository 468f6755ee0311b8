//! What a complete run needs to be still complete: the keys and contents that must exist. With it the next run need not read
//! and resolve the pipeline if nothing changed. It is used only if everything that it was made from is the same, and what it
//! lists is still checked, so correctness does not depend on it: if it is lost or damaged, a run takes a few milliseconds more.
//!
//! `settled-v1/<name>` holds, with numbers in little-endian: the digest of what follows; the digest of what it was made
//! from; the number of stages; length and bytes of the caller's note; number of keys, then keys; number of contents,
//! then digest and length of each.

use std::collections::{BTreeMap, BTreeSet};
use std::path::PathBuf;
use std::time::SystemTime;

use rayon::prelude::*;

use super::{Digest, Key, Store, StoreError};
use crate::fsx;

/// What must exist for a run to be still complete.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct CompleteRun {
    /// How many stages the pipeline has.
    pub stages: u64,
    /// Data of the caller.
    pub note: Vec<u8>,
    /// Keys of all stages.
    pub keys: BTreeSet<Key>,
    /// All outputs, with their lengths.
    pub contents: BTreeMap<Digest, u64>,
}

/// A complete run as `gc` sees it.
pub(super) struct KeptRun {
    /// Its file.
    pub path: PathBuf,
    /// When it was last found to be still complete.
    pub used: SystemTime,
    /// The keys of its results; none where the file is damaged.
    pub keys: BTreeSet<Key>,
}

impl Store {
    /// The complete run that was stored under `name` and made from the same; `None` where there is none or something that it
    /// lists is missing.
    pub fn complete_run(&self, name: &Digest, made_from: &Digest) -> Result<Option<CompleteRun>, StoreError> {
        let path = self.root().join("settled-v1").join(name.hex());
        let Some(bytes) = fsx::read_if_there(&path)? else { return Ok(None) };
        let Some(complete) = decode(&bytes, Some(made_from)) else { return Ok(None) };
        let keys: Vec<&Key> = complete.keys.iter().collect();
        let contents: Vec<(&Digest, &u64)> = complete.contents.iter().collect();
        let keys = keys.par_iter().map(|key| self.has_record(key));
        let there = keys.try_reduce(|| true, |one, other| Ok(one && other))?;
        let contents = contents.par_iter().map(|(digest, bytes)| self.has_blob(digest, **bytes));
        let there = there && contents.try_reduce(|| true, |one, other| Ok(one && other))?;
        Ok(there.then_some(complete))
    }

    /// Stores a complete run. It need not survive a power failure: half a file is ignored.
    pub fn keep_complete_run(
        &self,
        name: &Digest,
        made_from: &Digest,
        complete: &CompleteRun,
    ) -> Result<(), StoreError> {
        let folder = self.root().join("settled-v1");
        let path = folder.join(name.hex());
        let bytes = encode(complete, made_from);
        if fsx::read_if_there(&path)?.as_deref() == Some(&*bytes) {
            self.touch_complete_run(name);
            return Ok(());
        }
        fsx::create_dir_all(&folder)?;
        let draft = folder.join(format!("{name}.{}", std::process::id()));
        fsx::write(&draft, &bytes)?;
        Ok(fsx::rename(&draft, &path)?)
    }

    /// Marks the results of a complete run as used now, for `gc`. A store that cannot be written is not an error.
    pub fn touch_complete_run(&self, name: &Digest) {
        let _ = fsx::touch(&self.root().join("settled-v1").join(name.hex()));
    }

    /// Every complete run that is stored.
    pub(super) fn complete_runs(&self) -> Result<Vec<KeptRun>, StoreError> {
        let mut all = Vec::new();
        for path in fsx::list(&self.root().join("settled-v1"))? {
            // Another process may replace or remove it meanwhile.
            let (Some(used), Some(bytes)) = (fsx::modified(&path)?, fsx::read_if_there(&path)?) else {
                continue;
            };
            let keys = decode(&bytes, None).map(|complete| complete.keys).unwrap_or_default();
            all.push(KeptRun { path, used, keys });
        }
        Ok(all)
    }
}

fn encode(complete: &CompleteRun, made_from: &Digest) -> Vec<u8> {
    let mut body = made_from.as_bytes().to_vec();
    let number = |body: &mut Vec<u8>, number: u64| body.extend_from_slice(&number.to_le_bytes());
    number(&mut body, complete.stages);
    number(&mut body, complete.note.len() as u64);
    body.extend_from_slice(&complete.note);
    number(&mut body, complete.keys.len() as u64);
    for key in &complete.keys {
        body.extend_from_slice(key.as_bytes());
    }
    number(&mut body, complete.contents.len() as u64);
    for (digest, bytes) in &complete.contents {
        body.extend_from_slice(digest.as_bytes());
        number(&mut body, *bytes);
    }
    [Digest::of(&body).as_bytes(), &*body].concat()
}

/// A complete run that was made from `made_from`, if given.
fn decode(bytes: &[u8], made_from: Option<&Digest>) -> Option<CompleteRun> {
    let (digest, body) = bytes.split_first_chunk::<32>()?;
    let (from, rest) = body.split_first_chunk::<32>()?;
    if made_from.is_some_and(|wanted| from != wanted.as_bytes()) || Digest::of(body).as_bytes() != digest {
        return None;
    }
    let mut rest = rest;
    let stages = number(&mut rest)?;
    let length = usize::try_from(number(&mut rest)?).ok()?;
    let (note, behind) = rest.split_at_checked(length)?;
    rest = behind;
    let mut complete = CompleteRun { stages, note: note.to_vec(), ..CompleteRun::default() };
    for _ in 0..number(&mut rest)? {
        complete.keys.insert(Key::new(name(&mut rest)?));
    }
    for _ in 0..number(&mut rest)? {
        let digest = Digest::new(name(&mut rest)?);
        complete.contents.insert(digest, number(&mut rest)?);
    }
    rest.is_empty().then_some(complete)
}

fn number(rest: &mut &[u8]) -> Option<u64> {
    let (bytes, behind) = rest.split_first_chunk::<8>()?;
    *rest = behind;
    Some(u64::from_le_bytes(*bytes))
}

fn name(rest: &mut &[u8]) -> Option<[u8; 32]> {
    let (bytes, behind) = rest.split_first_chunk::<32>()?;
    *rest = behind;
    Some(*bytes)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_complete_run_is_used_only_if_whole_and_made_from_the_same() {
        let from = Digest::of(b"circumstances");
        let complete = CompleteRun {
            stages: 3,
            note: b"note".to_vec(),
            keys: [Key::new([1; 32]), Key::new([2; 32])].into(),
            contents: [(Digest::new([3; 32]), 7)].into(),
        };
        let bytes = encode(&complete, &from);
        assert_eq!(decode(&bytes, Some(&from)), Some(complete));
        assert_eq!(decode(&bytes, Some(&Digest::of(b"others"))), None);
        for cut in 0..bytes.len() {
            assert_eq!(decode(&bytes[..cut], None), None, "{cut}");
            let mut bent = bytes.clone();
            bent[cut] ^= 1;
            assert_eq!(decode(&bent, None), None, "{cut}");
        }
    }

    #[test]
    fn what_a_complete_run_lists_is_checked_in_the_store() {
        let folder = tempfile::tempdir().unwrap();
        let store = Store::open(folder.path()).unwrap();
        let (name, from) = (Digest::of(b"name"), Digest::of(b"from"));
        let content = Digest::of(b"abc");
        let complete = CompleteRun { contents: [(content, 3)].into(), ..CompleteRun::default() };
        store.keep_complete_run(&name, &from, &complete).unwrap();
        assert_eq!(store.complete_run(&name, &from).unwrap(), None);
        fsx::create_dir_all(store.blob_path(&content).parent().unwrap()).unwrap();
        fsx::write(&store.blob_path(&content), b"ab").unwrap();
        assert_eq!(store.complete_run(&name, &from).unwrap(), None);
        fsx::write(&store.blob_path(&content), b"abc").unwrap();
        assert_eq!(store.complete_run(&name, &from).unwrap(), Some(complete));
        assert_eq!(store.complete_run(&from, &from).unwrap(), None);
    }
}
