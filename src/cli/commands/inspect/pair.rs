//! A stage in two runs, for `diff`.

use std::collections::BTreeSet;

use super::ids;
use crate::error::Error;
use crate::plan::{self, Reason};
use crate::store::{Key, PastRun, Record, Store, Stored};

/// A stage in one of the runs.
pub(super) struct Side {
    pub fate: &'static str,
    pub key: Option<Key>,
    pub record: Option<Record>,
}

/// A stage in both.
pub(super) struct Pair<'a> {
    pub id: &'a str,
    pub then: Side,
    pub now: Side,
}

/// The fate of a stage that a run does not have.
const MISSING: &str = "missing";

impl Side {
    /// True where that run does not have the stage.
    pub fn is_missing(&self) -> bool {
        self.fate == MISSING
    }

    /// True for the same key and the same outcome; cached or run makes no difference.
    pub fn same(&self, other: &Self) -> bool {
        self.key == other.key && self.key.is_some() && self.record.is_some() == other.record.is_some()
    }

    /// Its outcome.
    pub fn fate(&self) -> &'static str {
        // For a comparison of results, cached and run are the same.
        if self.record.is_some() { "done" } else { self.fate }
    }
}

impl<'a> Pair<'a> {
    /// The stage with this id.
    ///
    /// # Errors
    /// The store cannot be read.
    pub fn of(id: &'a str, store: &Store, first: &PastRun, second: &PastRun) -> Result<Self, Error> {
        Ok(Self { id, then: side(store, first, id)?, now: side(store, second, id)? })
    }

    /// What became of it in both runs, where there is nothing more to say.
    pub fn fates(&self) -> Option<(&'a str, &'static str, &'static str)> {
        let both = self.then.record.is_some() && self.now.record.is_some();
        (!both).then(|| (ids::parts(self.id).0, self.then.fate(), self.now.fate()))
    }

    /// What differs, where both runs have its result.
    pub fn reasons(&self) -> Vec<Reason> {
        match (&self.then.record, &self.now.record) {
            (Some(then), Some(now)) => plan::compare(then, now),
            _ => Vec::new(),
        }
    }

    /// Output, what it was, what it is; those that differ.
    pub fn results(&self) -> Vec<(&String, Option<&Stored>, Option<&Stored>)> {
        let (Some(then), Some(now)) = (&self.then.record, &self.now.record) else { return Vec::new() };
        let names: BTreeSet<&String> = then.outputs.keys().chain(now.outputs.keys()).collect();
        let both = names.into_iter().map(|name| (name, then.outputs.get(name), now.outputs.get(name)));
        both.filter(|(_, then, now)| then.map(|it| it.digest) != now.map(|it| it.digest)).collect()
    }
}

fn side(store: &Store, run: &PastRun, id: &str) -> Result<Side, Error> {
    let Some(stage) = run.stages.get(id) else {
        return Ok(Side { fate: MISSING, key: None, record: None });
    };
    let record = match stage.key {
        Some(key) => store.record(&key)?,
        None => None,
    };
    Ok(Side { fate: stage.fate.name(), key: stage.key, record })
}
