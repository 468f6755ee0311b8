//! Takes results from a shared cache. Nothing in it is believed: every content is hashed after it was written to the disk,
//! the key of every record is computed from the record, and no name from the cache becomes a path.

use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::sync::{Mutex, OnceLock, PoisonError};

use serde_json::json;

use super::link::{Trouble, in_parallel};
use super::wire::{Fault, WireError};
use super::{Problem, Remote, Unusable, blob_name};
use crate::fsx::{self, Entry};
use crate::store::{Digest, Fingerprint, Key, Outputs, Run, Store, StoreError, hash_file};

/// Threads that fetch the contents of one result; many results are worked on at the same time.
const PER_RESULT: usize = 8;

/// How often a content may come with other bytes until it counts as damaged there.
const WRONG: u32 = 3;

/// Numbers for temporary files.
static COPIES: AtomicU64 = AtomicU64::new(0);

/// What came of taking results from a shared cache.
#[derive(Debug, Default)]
pub struct Pulled {
    /// Results that are new here.
    pub new: Vec<Key>,
    /// Results that were here already.
    pub known: usize,
    /// Results that are not in the cache.
    pub absent: usize,
    /// Contents that were fetched.
    pub contents: usize,
    /// Their bytes.
    pub bytes: u64,
    /// Results that are there and were not taken, and why not.
    pub refused: Vec<Problem>,
    /// Why the cache was given up; the results that were not reached are in none of the other fields.
    pub given_up: Option<String>,
    /// Keeps what was taken from being removed.
    _run: Option<Run>,
}

/// A pull in progress.
pub(super) struct Pull<'a> {
    remote: &'a Remote,
    store: &'a Store,
    stop: &'a AtomicBool,
    /// Begun when the first content is fetched.
    run: OnceLock<Run>,
    beginning: Mutex<()>,
    pulled: Mutex<Pulled>,
    /// This store cannot be written.
    broken: Mutex<Option<StoreError>>,
    over: AtomicBool,
}

/// Why a result was not taken.
enum Why {
    GivenUp,
    Refused(String),
    Store(StoreError),
}

impl<'a> Pull<'a> {
    pub fn new(remote: &'a Remote, store: &'a Store, stop: &'a AtomicBool) -> Self {
        Self {
            remote,
            store,
            stop,
            run: OnceLock::new(),
            beginning: Mutex::new(()),
            pulled: Mutex::default(),
            broken: Mutex::default(),
            over: AtomicBool::new(false),
        }
    }

    pub fn run(self, keys: &[Key], done: &(dyn Fn() + Sync)) -> Result<Pulled, StoreError> {
        in_parallel(keys, self.remote.parallel, &self.over, |key| {
            self.take(key);
            done();
        });
        if let Some(error) = self.broken.into_inner().unwrap_or_else(PoisonError::into_inner) {
            return Err(error);
        }
        let mut pulled = self.pulled.into_inner().unwrap_or_else(PoisonError::into_inner);
        pulled.given_up = self.remote.given_up();
        pulled.new.sort_unstable();
        pulled.refused.sort();
        if let Some(run) = self.run.into_inner() {
            // It has neither events nor logs to show.
            fsx::remove_dir_all(run.folder())?;
            pulled._run = Some(run);
        }
        Ok(pulled)
    }

    fn count(&self, with: impl FnOnce(&mut Pulled)) {
        with(&mut self.pulled.lock().unwrap_or_else(PoisonError::into_inner));
    }

    fn take(&self, key: &Key) {
        if self.stop.load(Ordering::Relaxed) {
            self.over.store(true, Ordering::Relaxed);
            return;
        }
        match self.result(key) {
            Ok(Taken::New) => self.count(|pulled| pulled.new.push(*key)),
            Ok(Taken::Known) => self.count(|pulled| pulled.known += 1),
            Ok(Taken::Absent) => self.count(|pulled| pulled.absent += 1),
            Err(Why::Refused(why)) => self.count(|pulled| pulled.refused.push(Problem { key: *key, why })),
            Err(Why::GivenUp) => self.over.store(true, Ordering::Relaxed),
            Err(Why::Store(error)) => {
                self.over.store(true, Ordering::Relaxed);
                self.broken.lock().unwrap_or_else(PoisonError::into_inner).get_or_insert(error);
            }
        }
    }

    fn is_here(&self, key: &Key) -> Result<bool, StoreError> {
        match self.store.record(key)? {
            Some(record) => Ok(self.store.lost(&record.outputs)?.is_none()),
            None => Ok(false),
        }
    }

    fn result(&self, key: &Key) -> Result<Taken, Why> {
        if self.is_here(key)? {
            return Ok(Taken::Known);
        }
        let record = match self.remote.record(key) {
            Ok(Some(record)) => record,
            Ok(None) => return Ok(Taken::Absent),
            Err(Unusable::Refused(why)) => return Err(Why::Refused(why)),
            Err(Unusable::Trouble(trouble)) => return Err(trouble.into()),
        };
        let run = self.run_of_this()?;
        // Who makes it here, or takes it from there, at this moment is not disturbed.
        let Some(lock) = self.store.try_lock(key)? else { return Ok(Taken::Known) };
        run.rely_on([*key], [])?;
        let taken = self.outputs(&record.outputs, run).and_then(|()| {
            if self.is_here(key)? {
                return Ok(Taken::Known);
            }
            let folder = run.temporary().join(key.hex());
            fsx::create_dir_all(&folder).map_err(StoreError::from)?;
            self.store.commit(key, &record, &[], &folder)?;
            Ok(Taken::New)
        });
        lock.remove().map_err(StoreError::from)?;
        taken
    }

    /// Fetches all that the outputs are made of, and makes it durable.
    fn outputs(&self, outputs: &Outputs, run: &Run) -> Result<(), Why> {
        let contents: Vec<(Digest, u64)> =
            outputs.values().map(|stored| (stored.digest, stored.bytes)).collect();
        self.contents(&contents, run)?;
        // What is in a folder is known once its list is here, and hashed.
        for stored in outputs.values().filter(|stored| stored.folder) {
            if self.store.folder(&stored.digest)?.is_none() {
                return Err(Why::Refused(format!(
                    "its folder {} is no list of files",
                    stored.digest.short()
                )));
            }
            let inside: Vec<(Digest, u64)> = self.store.contents(stored)?.into_iter().skip(1).collect();
            self.contents(&inside, run)?;
        }
        Ok(())
    }

    fn contents(&self, contents: &[(Digest, u64)], run: &Run) -> Result<(), Why> {
        let failure = Mutex::new(None);
        in_parallel(contents, PER_RESULT, &self.over, |(digest, bytes)| {
            if let Err(why) = self.content(digest, *bytes, run) {
                failure.lock().unwrap_or_else(PoisonError::into_inner).get_or_insert(why);
            }
        });
        match failure.into_inner().unwrap_or_else(PoisonError::into_inner) {
            Some(why) => Err(why),
            None if self.over.load(Ordering::Relaxed) => Err(Why::GivenUp),
            None => Ok(()),
        }
    }

    /// Fetches a content that is not here.
    fn content(&self, digest: &Digest, bytes: u64, run: &Run) -> Result<(), Why> {
        let is_here = {
            run.rely_on([], [*digest])?;
            let _held = self.store.hold()?;
            fsx::entry(&self.store.blob_path(digest)).map_err(StoreError::from)? == Some(Entry::File(bytes))
        };
        if is_here {
            return Ok(());
        }
        let copy = run.temporary().join(format!("fetched-{}", COPIES.fetch_add(1, Ordering::Relaxed)));
        let name = blob_name(digest);
        let mut wrong = 0;
        let fetched = self.remote.link.ask(|wire| {
            let mut file = fsx::create(&copy).map_err(here)?;
            let Some(there) = wire.get(&name, &mut file, bytes)? else { return Ok(Fetched::Absent) };
            drop(file);
            let (seen, _) = hash_file(&copy).map_err(here)?;
            if there == bytes && seen == *digest {
                return Ok(Fetched::Sound);
            }
            // A connection that was cut may look like the end of the object: it is fetched again.
            wrong += 1;
            if wrong < WRONG {
                return Err(WireError::new(Fault::Transient, "other bytes than expected"));
            }
            Ok(Fetched::Other(seen))
        })?;
        match fetched {
            Fetched::Sound => {
                self.store.take(&copy)?.sync().map_err(StoreError::from)?;
                self.count(|pulled| {
                    pulled.contents += 1;
                    pulled.bytes += bytes;
                });
                Ok(())
            }
            Fetched::Absent => Err(Why::Refused(format!("its content {} is not there", digest.short()))),
            Fetched::Other(seen) => {
                let _ = fsx::remove_file(&copy);
                let (digest, seen) = (digest.short(), seen.short());
                Err(Why::Refused(format!("its content {digest} is damaged there: what came is {seen}")))
            }
        }
    }

    fn run_of_this(&self) -> Result<&Run, StoreError> {
        let _alone = self.beginning.lock().unwrap_or_else(PoisonError::into_inner);
        if let Some(run) = self.run.get() {
            return Ok(run);
        }
        let run = self.store.begin_run(&json!({
            "version": 1, "pipeline": "", "profile": "", "pull": true, "fingerprint": Fingerprint::current(),
        }))?;
        Ok(self.run.get_or_init(|| run))
    }
}

/// A file here that cannot be written is no fault of the server.
fn here(error: fsx::FsError) -> WireError {
    WireError::new(Fault::Object, error.to_string())
}

enum Taken {
    New,
    Known,
    Absent,
}

enum Fetched {
    Sound,
    Absent,
    Other(Digest),
}

impl From<Trouble> for Why {
    fn from(trouble: Trouble) -> Self {
        match trouble {
            Trouble::GivenUp => Self::GivenUp,
            Trouble::Failed(why) => Self::Refused(why),
        }
    }
}

impl From<StoreError> for Why {
    fn from(error: StoreError) -> Self {
        Self::Store(error)
    }
}
