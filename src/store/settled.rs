//! What a complete run found, so that the next one need not read and resolve the pipeline again where nothing changed:
//! the keys and contents that have to be there. It is only believed where all that it was made from is the same, and what
//! it names is still looked for, so nothing rests on it: a lost or damaged note costs a few milliseconds.
//!
//! `settled-v1/<name>` holds, with numbers in little-endian: the digest of what follows; the digest of what it was made
//! from; the number of stages; length and bytes of a note of the caller; number of keys, then keys; number of contents,
//! then digest and length of each.

use std::collections::{BTreeMap, BTreeSet};

use rayon::prelude::*;

use super::{Digest, Key, Store, StoreError};
use crate::fsx;

/// What has to be there.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Settled {
    /// How many stages the pipeline has.
    pub stages: u64,
    /// Whatever the caller wants to know again.
    pub note: Vec<u8>,
    /// Keys of all stages.
    pub keys: BTreeSet<Key>,
    /// All outputs, with their lengths.
    pub contents: BTreeMap<Digest, u64>,
}

impl Store {
    /// What was settled under `name` from just these circumstances; `None` where nothing was, or not all of it is there.
    ///
    /// # Errors
    /// The store cannot be read.
    pub fn settled(&self, name: &Digest, made_from: &Digest) -> Result<Option<Settled>, StoreError> {
        let path = self.root().join("settled-v1").join(name.hex());
        let Some(bytes) = fsx::read_if_there(&path)? else { return Ok(None) };
        let Some(settled) = decode(&bytes, made_from) else { return Ok(None) };
        let keys: Vec<&Key> = settled.keys.iter().collect();
        let contents: Vec<(&Digest, &u64)> = settled.contents.iter().collect();
        let keys = keys.par_iter().map(|key| self.has_record(key));
        let there = keys.try_reduce(|| true, |one, other| Ok(one && other))?;
        let contents = contents.par_iter().map(|(digest, bytes)| self.has_blob(digest, **bytes));
        let there = there && contents.try_reduce(|| true, |one, other| Ok(one && other))?;
        Ok(there.then_some(settled))
    }

    /// Notes what a complete run found. Nothing is promised about power failures: half a note is none.
    ///
    /// # Errors
    /// The store cannot be written.
    pub fn settle(&self, name: &Digest, made_from: &Digest, settled: &Settled) -> Result<(), StoreError> {
        let folder = self.root().join("settled-v1");
        let path = folder.join(name.hex());
        let bytes = encode(settled, made_from);
        if fsx::read_if_there(&path)?.as_deref() == Some(&*bytes) {
            return Ok(());
        }
        fsx::create_dir_all(&folder)?;
        let draft = folder.join(format!("{name}.{}", std::process::id()));
        fsx::write(&draft, &bytes)?;
        Ok(fsx::rename(&draft, &path)?)
    }
}

fn encode(settled: &Settled, made_from: &Digest) -> Vec<u8> {
    let mut body = made_from.as_bytes().to_vec();
    let number = |body: &mut Vec<u8>, number: u64| body.extend_from_slice(&number.to_le_bytes());
    number(&mut body, settled.stages);
    number(&mut body, settled.note.len() as u64);
    body.extend_from_slice(&settled.note);
    number(&mut body, settled.keys.len() as u64);
    for key in &settled.keys {
        body.extend_from_slice(key.as_bytes());
    }
    number(&mut body, settled.contents.len() as u64);
    for (digest, bytes) in &settled.contents {
        body.extend_from_slice(digest.as_bytes());
        number(&mut body, *bytes);
    }
    [Digest::of(&body).as_bytes(), &*body].concat()
}

fn decode(bytes: &[u8], made_from: &Digest) -> Option<Settled> {
    let (digest, body) = bytes.split_first_chunk::<32>()?;
    let (from, rest) = body.split_first_chunk::<32>()?;
    if from != made_from.as_bytes() || Digest::of(body).as_bytes() != digest {
        return None;
    }
    let mut rest = rest;
    let stages = number(&mut rest)?;
    let length = usize::try_from(number(&mut rest)?).ok()?;
    let (note, behind) = rest.split_at_checked(length)?;
    rest = behind;
    let mut settled = Settled { stages, note: note.to_vec(), ..Settled::default() };
    for _ in 0..number(&mut rest)? {
        settled.keys.insert(Key::new(name(&mut rest)?));
    }
    for _ in 0..number(&mut rest)? {
        let digest = Digest::new(name(&mut rest)?);
        settled.contents.insert(digest, number(&mut rest)?);
    }
    rest.is_empty().then_some(settled)
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
    fn a_note_is_believed_only_whole_and_under_the_same_circumstances() {
        let from = Digest::of(b"circumstances");
        let settled = Settled {
            stages: 3,
            note: b"note".to_vec(),
            keys: [Key::new([1; 32]), Key::new([2; 32])].into(),
            contents: [(Digest::new([3; 32]), 7)].into(),
        };
        let bytes = encode(&settled, &from);
        assert_eq!(decode(&bytes, &from), Some(settled));
        assert_eq!(decode(&bytes, &Digest::of(b"others")), None);
        for cut in 0..bytes.len() {
            assert_eq!(decode(&bytes[..cut], &from), None, "{cut}");
            let mut bent = bytes.clone();
            bent[cut] ^= 1;
            assert_eq!(decode(&bent, &from), None, "{cut}");
        }
    }

    #[test]
    fn what_is_settled_is_looked_for_in_the_store() {
        let folder = tempfile::tempdir().unwrap();
        let store = Store::open(folder.path()).unwrap();
        let (name, from) = (Digest::of(b"name"), Digest::of(b"from"));
        let content = Digest::of(b"abc");
        let settled = Settled { contents: [(content, 3)].into(), ..Settled::default() };
        store.settle(&name, &from, &settled).unwrap();
        assert_eq!(store.settled(&name, &from).unwrap(), None);
        fsx::create_dir_all(store.blob_path(&content).parent().unwrap()).unwrap();
        fsx::write(&store.blob_path(&content), b"ab").unwrap();
        assert_eq!(store.settled(&name, &from).unwrap(), None);
        fsx::write(&store.blob_path(&content), b"abc").unwrap();
        assert_eq!(store.settled(&name, &from).unwrap(), Some(settled));
        assert_eq!(store.settled(&from, &from).unwrap(), None);
    }
}
