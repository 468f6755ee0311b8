//! A cache that several machines share: results go from a store to a server and from there to other stores.
//!
//! The server keeps objects under names, as S3 does; they are laid out like a store (`docs/design/remote.md`):
//!
//! ```text
//! blobs-v1/ab/cdef…          a content, named by the blake3 of its bytes
//! records-v1/ab/cdef….json   a record, named by its key; created last, and never replaced
//! ```
//!
//! The cache may be slow, cut off, damaged or hostile: it can cost time, and never a run or a wrong result.

mod link;
#[cfg(test)]
mod memory;
mod profile;
mod pull;
mod push;
mod seal;
mod wire;

#[cfg(feature = "remote")]
mod servers;
#[cfg(not(feature = "remote"))]
#[path = "without_servers.rs"]
mod servers;

use std::collections::BTreeMap;
use std::sync::atomic::AtomicBool;
use std::time::Duration;

pub use profile::variables_of;
pub use pull::Pulled;
pub use push::{Difference, Pushed};
pub use seal::Secret;
pub use wire::{Fault, Wire, WireError};

use crate::store::{Digest, Key, KeyOf, RECORD_VERSION, Record, Store, StoreError};
use link::{Link, Trouble};

/// A record larger than this is none.
const LARGEST_RECORD: u64 = 64 << 20;

/// Before the second try of a request.
const PAUSE: Duration = Duration::from_millis(200);

/// Where a shared cache is, and how it is used.
#[derive(Clone, Debug)]
pub struct Address {
    /// `s3://bucket/prefix`, `file:///folder`, `http://host/path` or `https://host/path`.
    pub url: String,
    /// Requests that may be under way at the same time, at least 1.
    pub parallel: usize,
    /// A connection on which nothing moves for so long is given up.
    pub timeout: Duration,
    /// A secret that signs records; without one, records are neither signed nor checked for a signature.
    pub secret: Option<Secret>,
    /// Variables that say how to reach the server, as the AWS tools read them (`AWS_ACCESS_KEY_ID`, `AWS_ENDPOINT_URL` …).
    pub variables: BTreeMap<String, String>,
}

/// Why a shared cache cannot be used.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum RemoteError {
    /// The URL names no cache.
    #[error("`{url}` is no shared cache: {why}")]
    Url {
        /// The URL.
        url: String,
        /// What was seen and what was expected.
        why: String,
    },
    /// This program was built without the feature `remote`.
    #[error("this program was built without shared caches")]
    NotBuilt,
    /// The cache does not answer, or not as expected.
    #[error("the shared cache does not answer: {0}")]
    NoAnswer(String),
}

/// Something that was not given or taken, and why not.
#[derive(Clone, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub struct Problem {
    /// The result.
    pub key: Key,
    /// What was seen and what was expected.
    pub why: String,
}

/// How a store and a shared cache compare.
#[derive(Clone, Debug, Default)]
pub struct Compared {
    /// Results that are in the cache.
    pub there: Vec<Key>,
    /// Results that are not.
    pub absent: Vec<Key>,
    /// Results that are there with other contents than in the store.
    pub different: Vec<Difference>,
    /// Results in whose place there is something else.
    pub refused: Vec<Problem>,
    /// Why the cache was given up.
    pub given_up: Option<String>,
}

/// A shared cache.
pub struct Remote {
    link: Link,
    parallel: usize,
    secret: Option<Secret>,
    key_of: KeyOf,
}

/// Why there is no record to work with.
enum Unusable {
    /// There is something, but it is no record of this work.
    Refused(String),
    Trouble(Trouble),
}

impl Remote {
    /// The cache at an address. Makes no request yet.
    ///
    /// # Errors
    /// The URL is not one of a cache, settings for the server are wrong or missing, or the program was built without the
    /// feature `remote`.
    pub fn open(address: &Address, key_of: KeyOf) -> Result<Self, RemoteError> {
        Ok(Self::over(servers::connect(address)?, address.parallel, address.secret.clone(), PAUSE, key_of))
    }

    /// A cache that is reached by `wire`; `pause` is the time before the second try of a request.
    pub fn over(
        wire: Box<dyn Wire>,
        parallel: usize,
        secret: Option<Secret>,
        pause: Duration,
        key_of: KeyOf,
    ) -> Self {
        Self { link: Link::new(wire, parallel, pause), parallel: parallel.max(1), secret, key_of }
    }

    /// One that does not answer, for this reason: it is asked nothing.
    pub fn gone(why: String) -> Self {
        Self { link: Link::gone(why), parallel: 1, secret: None, key_of: |_| None }
    }

    /// True where results can only be taken.
    pub fn is_read_only(&self) -> bool {
        self.link.is_read_only()
    }

    /// Why the cache was given up; `None` as long as it was not. A cache that was given up is asked no more.
    pub fn given_up(&self) -> Option<String> {
        self.link.given_up()
    }

    /// Gives results of a store. `done` is called after each. Ends soon after `stop` becomes true.
    pub fn push(&self, store: &Store, keys: &[Key], stop: &AtomicBool, done: &(dyn Fn() + Sync)) -> Pushed {
        push::Push::new(self, store, stop).run(keys, done)
    }

    /// Takes results that are missing in a store. `done` is called after each. Ends soon after `stop` becomes true. What
    /// was taken is not removed by anybody as long as the answer is kept.
    ///
    /// # Errors
    /// The store cannot be written; what was taken until then is whole.
    pub fn pull(
        &self,
        store: &Store,
        keys: &[Key],
        stop: &AtomicBool,
        done: &(dyn Fn() + Sync),
    ) -> Result<Pulled, StoreError> {
        pull::Pull::new(self, store, stop).run(keys, done)
    }

    /// The keys of all results in the cache, sorted.
    ///
    /// # Errors
    /// The cache does not answer, or cannot list.
    pub fn keys(&self) -> Result<Vec<Key>, RemoteError> {
        let names = self.link.ask(|wire| wire.list(RECORDS)).map_err(|trouble| {
            RemoteError::NoAnswer(match trouble {
                Trouble::Failed(why) => why,
                Trouble::GivenUp => self.given_up().unwrap_or_default(),
            })
        })?;
        let key =
            |name: &String| name.strip_prefix(RECORDS)?.strip_suffix(".json")?.replace('/', "").parse().ok();
        let mut keys: Vec<Key> = names.iter().filter_map(key).collect();
        keys.sort_unstable();
        keys.dedup();
        Ok(keys)
    }

    /// Looks which of these results are in the cache, and whether they are what they are here.
    pub fn compare(&self, store: &Store, keys: &[Key]) -> Compared {
        let all = std::sync::Mutex::new(Compared::default());
        link::in_parallel(keys, self.parallel, &AtomicBool::new(false), |key| {
            let there = self.record(key);
            let here = store.record(key).ok().flatten();
            let mut all = all.lock().unwrap_or_else(std::sync::PoisonError::into_inner);
            match there {
                Ok(Some(there)) => {
                    all.there.push(*key);
                    let different = here
                        .and_then(|here| push::difference(*key, &here.stage, &here.outputs, &there.outputs));
                    all.different.extend(different);
                }
                Ok(None) => all.absent.push(*key),
                Err(Unusable::Refused(why) | Unusable::Trouble(Trouble::Failed(why))) => {
                    all.refused.push(Problem { key: *key, why });
                }
                Err(Unusable::Trouble(Trouble::GivenUp)) => {}
            }
        });
        let mut all = all.into_inner().unwrap_or_else(std::sync::PoisonError::into_inner);
        all.given_up = self.given_up();
        all.there.sort_unstable();
        all.absent.sort_unstable();
        all
    }

    /// The record of a key in the cache, checked: its signature, its version, and that it belongs to the key.
    fn record(&self, key: &Key) -> Result<Option<Record>, Unusable> {
        let fetched = self.link.ask(|wire| {
            let mut bytes = Vec::new();
            Ok(wire.get(&record_name(key), &mut bytes, LARGEST_RECORD)?.map(|_| bytes))
        });
        let Some(object) = fetched.map_err(Unusable::Trouble)? else { return Ok(None) };
        let bytes = seal::open(key, &object, self.secret.as_ref())
            .map_err(|why| Unusable::Refused(format!("its record was not taken: {why}")))?;
        let record: Record = serde_json::from_slice(bytes)
            .map_err(|error| Unusable::Refused(format!("its record cannot be read: {error}")))?;
        if record.version != RECORD_VERSION {
            let why = format!("its record has version {}, expected {RECORD_VERSION}", record.version);
            return Err(Unusable::Refused(why));
        }
        if (self.key_of)(&record) != Some(*key) {
            return Err(Unusable::Refused("its record is that of other work".to_owned()));
        }
        Ok(Some(record))
    }
}

/// The folder of the records.
const RECORDS: &str = "records-v1";

fn record_name(key: &Key) -> String {
    let hex = key.hex();
    let (shard, rest) = hex.split_at(2);
    format!("{RECORDS}/{shard}/{rest}.json")
}

fn blob_name(digest: &Digest) -> String {
    let hex = digest.hex();
    let (shard, rest) = hex.split_at(2);
    format!("blobs-v1/{shard}/{rest}")
}

#[cfg(test)]
mod tests;
