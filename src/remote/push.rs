//! Gives results to a shared cache: contents first, then the record, which is created only if there is none. So a result
//! is visible as a whole or not at all, and the first one to give it stays.

use std::collections::{BTreeSet, HashSet};
use std::sync::atomic::AtomicBool;
use std::sync::{Mutex, PoisonError};

use super::link::{Trouble, in_parallel};
use super::wire::{Fault, WireError};
use super::{Problem, Remote, blob_name, record_name, seal};
use crate::store::{Digest, Key, Outputs, Record, Store, StoreError};

/// Threads that upload the contents of one result; many results are worked on at the same time.
const PER_RESULT: usize = 8;

/// How often a record that is refused and not there is created again.
const CONFLICTS: u32 = 5;

/// What came of giving results to a shared cache.
#[derive(Clone, Debug, Default)]
pub struct Pushed {
    /// Results that are new there.
    pub new: usize,
    /// Results that were there already, with the same contents.
    pub known: usize,
    /// Contents that were uploaded.
    pub contents: usize,
    /// Their bytes.
    pub bytes: u64,
    /// Results that are there with other contents.
    pub different: Vec<Difference>,
    /// Results that could not be given, and why not.
    pub failed: Vec<Problem>,
    /// Why the cache was given up; the results that were not reached are in none of the other fields.
    pub given_up: Option<String>,
}

/// A stage that is not deterministic: the same work has other results in the shared cache.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Difference {
    /// The work.
    pub key: Key,
    /// The stage that did it here.
    pub stage: String,
    /// The first output that differs.
    pub output: String,
    /// Its content here; `None` where there is no such output.
    pub here: Option<Digest>,
    /// Its content in the shared cache; `None` where there is no such output.
    pub there: Option<Digest>,
}

impl std::fmt::Display for Difference {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        let shown = |digest: &Option<Digest>| digest.map_or("missing".to_owned(), |digest| digest.short());
        let (here, there) = (shown(&self.here), shown(&self.there));
        let Self { stage, output, key, .. } = self;
        write!(
            f,
            "`{stage}` is not deterministic: output `{output}` is {here} here and {there} in the shared cache (key {})",
            key.short()
        )
    }
}

/// The first output in which two results of the same work differ.
pub(super) fn difference(key: Key, stage: &str, here: &Outputs, there: &Outputs) -> Option<Difference> {
    let names: BTreeSet<&String> = here.keys().chain(there.keys()).collect();
    let digest = |outputs: &Outputs, name: &String| outputs.get(name).map(|stored| stored.digest);
    let output = names.into_iter().find(|name| digest(here, name) != digest(there, name))?;
    let (here, there) = (digest(here, output), digest(there, output));
    Some(Difference { key, stage: stage.to_owned(), output: output.clone(), here, there })
}

/// A push in progress.
pub(super) struct Push<'a> {
    remote: &'a Remote,
    store: &'a Store,
    stop: &'a AtomicBool,
    /// Contents that are known to be there.
    there: Mutex<HashSet<Digest>>,
    pushed: Mutex<Pushed>,
}

impl<'a> Push<'a> {
    pub fn new(remote: &'a Remote, store: &'a Store, stop: &'a AtomicBool) -> Self {
        Self { remote, store, stop, there: Mutex::default(), pushed: Mutex::default() }
    }

    pub fn run(self, keys: &[Key], done: &(dyn Fn() + Sync)) -> Pushed {
        in_parallel(keys, self.remote.parallel, self.stop, |key| {
            self.give(key);
            done();
        });
        let mut pushed = self.pushed.into_inner().unwrap_or_else(PoisonError::into_inner);
        pushed.given_up = self.remote.given_up();
        pushed.different.sort_by_key(|different| different.key);
        pushed.failed.sort();
        pushed
    }

    fn count(&self, with: impl FnOnce(&mut Pushed)) {
        with(&mut self.pushed.lock().unwrap_or_else(PoisonError::into_inner));
    }

    fn give(&self, key: &Key) {
        match self.result(key) {
            Ok(Given::New) => self.count(|pushed| pushed.new += 1),
            Ok(Given::Known) => self.count(|pushed| pushed.known += 1),
            Ok(Given::Different(different)) => self.count(|pushed| pushed.different.push(different)),
            Err(Why::Failed(why)) => self.count(|pushed| pushed.failed.push(Problem { key: *key, why })),
            Err(Why::GivenUp) => {}
        }
    }

    fn result(&self, key: &Key) -> Result<Given, Why> {
        let record = self.store.record(key)?;
        let record = record.filter(|record| (self.remote.key_of)(record) == Some(*key));
        let record = record.ok_or_else(|| Why::Failed("there is no sound record of it here".to_owned()))?;
        if let Some(output) = self.store.lost(&record.outputs)? {
            return Err(Why::Failed(format!("its output `{output}` is not in the store any more")));
        }
        // Contents that a clean-up removed from a bucket come back, even where the record is still there.
        let there = self.there(key)?;
        if let Some(there) = &there
            && let Some(different) = difference(*key, &record.stage, &record.outputs, &there.outputs)
        {
            return Ok(Given::Different(different));
        }
        self.contents(&record)?;
        if there.is_some() {
            return Ok(Given::Known);
        }
        self.create(key, &record)
    }

    /// The record in the cache, if it is one that others would take.
    fn there(&self, key: &Key) -> Result<Option<Record>, Why> {
        match self.remote.record(key) {
            Ok(record) => Ok(record),
            Err(super::Unusable::Refused(why)) => {
                Err(Why::Failed(format!("the cache has something else in its place: {why}")))
            }
            Err(super::Unusable::Trouble(trouble)) => Err(trouble.into()),
        }
    }

    fn create(&self, key: &Key, record: &Record) -> Result<Given, Why> {
        let bytes = serde_json::to_vec(record).map_err(|error| Why::Failed(error.to_string()))?;
        let object = seal::seal(key, bytes, self.remote.secret.as_ref());
        for _ in 0..CONFLICTS {
            if self.remote.link.ask(|wire| wire.create(&record_name(key), object.clone()))? {
                return Ok(Given::New);
            }
            // Another writer was faster, or the answer to an earlier try was lost. Where there is no record, two writers met,
            // and S3 refused both.
            if let Some(there) = self.there(key)? {
                let different = difference(*key, &record.stage, &record.outputs, &there.outputs);
                return Ok(different.map_or(Given::Known, Given::Different));
            }
        }
        Err(Why::Failed("its record can be neither created nor read".to_owned()))
    }

    fn contents(&self, record: &Record) -> Result<(), Why> {
        let mut contents = Vec::new();
        for stored in record.outputs.values() {
            contents.extend(self.store.contents(stored)?);
        }
        contents.sort_unstable();
        contents.dedup();
        let failure: Mutex<Option<Why>> = Mutex::new(None);
        in_parallel(&contents, PER_RESULT, self.stop, |(digest, bytes)| {
            if let Err(why) = self.content(digest, *bytes) {
                failure.lock().unwrap_or_else(PoisonError::into_inner).get_or_insert(why);
            }
        });
        match failure.into_inner().unwrap_or_else(PoisonError::into_inner) {
            Some(why) => Err(why),
            // A record must not be created before its contents are there.
            None if self.stop.load(std::sync::atomic::Ordering::Relaxed) => Err(Why::GivenUp),
            None => Ok(()),
        }
    }

    fn content(&self, digest: &Digest, bytes: u64) -> Result<(), Why> {
        let known = |digest| self.there.lock().unwrap_or_else(PoisonError::into_inner).contains(digest);
        let name = blob_name(digest);
        // A length that differs is what a server without atomic uploads may have left.
        if known(digest) || self.remote.link.ask(|wire| wire.size(&name))? == Some(bytes) {
            self.there.lock().unwrap_or_else(PoisonError::into_inner).insert(*digest);
            return Ok(());
        }
        let path = self.store.blob_path(digest);
        self.remote.link.ask(|wire| {
            let mut hasher = blake3::Hasher::new();
            let mut damaged = false;
            let sent = wire.upload(&name, &path, bytes, &mut |chunk| {
                hasher.update(chunk);
                damaged = chunk.is_empty() && hasher.finalize().as_bytes() != digest.as_bytes();
                !damaged
            });
            let text = || format!("the content {} is damaged in this store", digest.short());
            if damaged { Err(WireError::new(Fault::Object, text())) } else { sent }
        })?;
        self.there.lock().unwrap_or_else(PoisonError::into_inner).insert(*digest);
        self.count(|pushed| {
            pushed.contents += 1;
            pushed.bytes += bytes;
        });
        Ok(())
    }
}

enum Given {
    New,
    Known,
    Different(Difference),
}

enum Why {
    GivenUp,
    Failed(String),
}

impl From<Trouble> for Why {
    fn from(trouble: Trouble) -> Self {
        match trouble {
            Trouble::GivenUp => Self::GivenUp,
            Trouble::Failed(why) => Self::Failed(why),
        }
    }
}

impl From<StoreError> for Why {
    fn from(error: StoreError) -> Self {
        Self::Failed(error.to_string())
    }
}
