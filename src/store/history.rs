//! The key and outputs of each stage of a pipeline, run after run: `stage -> key, outputs`, one line each, in
//! `history-v1/<pipeline>-<profile>.jsonl`.
//!
//! It has two uses, and correctness depends on neither: `explain` compares a stage with its past, and a plan reads one file here
//! instead of thousands of records (it still checks that each record and blob exists). Invalid lines are skipped, so a torn line
//! or a lost file can cost an explanation, but never a result.

use std::borrow::Cow;
use std::collections::HashMap;
use std::path::{Path, PathBuf};
use std::sync::Arc;

use serde::{Deserialize, Serialize};

use super::{Key, Outputs, Store, StoreError};
use crate::fsx;

/// The number of lines that are gathered before they are written; the rest is written at the end of a run.
const BATCH: usize = 32;

/// The history of one pipeline with one profile.
#[derive(Debug, Default)]
pub struct History {
    path: PathBuf,
    stages: HashMap<String, Vec<Key>>,
    outputs: HashMap<Key, Arc<Outputs>>,
    lines: usize,
    unwritten: Vec<u8>,
    gathered: usize,
}

#[derive(Serialize, Deserialize)]
struct Line<'a> {
    #[serde(borrow)]
    stage: Cow<'a, str>,
    key: Key,
    outputs: Cow<'a, Outputs>,
}

impl Store {
    /// Reads a pipeline's history; an empty one where there is none.
    ///
    /// # Errors
    /// It exists and cannot be read.
    pub fn history(&self, pipeline: &str, profile: &str) -> Result<History, StoreError> {
        let path = self.history_path(pipeline, profile);
        let bytes = fsx::read_if_there(&path)?.unwrap_or_default();
        let mut history = History { path, ..History::default() };
        for line in bytes.split(|byte| *byte == b'\n').filter(|line| !line.is_empty()) {
            history.lines += 1;
            if let Ok(line) = serde_json::from_slice::<Line<'_>>(line) {
                history.insert(&line.stage, line.key, Arc::new(line.outputs.into_owned()));
            }
        }
        Ok(history)
    }
}

impl Store {
    fn history_path(&self, pipeline: &str, profile: &str) -> PathBuf {
        let name: String = format!("{pipeline}-{profile}")
            .chars()
            .map(|c| if c.is_alphanumeric() || "._-".contains(c) { c } else { '_' })
            .take(100)
            .collect();
        self.root().join("history-v1").join(format!("{name}.jsonl"))
    }

    /// As [`History::touch`], for a history that was not read.
    pub fn touch_history(&self, pipeline: &str, profile: &str) {
        let _ = fsx::touch(&self.history_path(pipeline, profile));
    }

    /// The latest key of every stage in a history file; invalid lines are skipped.
    pub(super) fn current_keys(&self, path: &Path) -> Result<Vec<Key>, StoreError> {
        let bytes = fsx::read_if_there(path)?.unwrap_or_default();
        let mut current: HashMap<String, Key> = HashMap::new();
        for line in bytes.split(|byte| *byte == b'\n').filter(|line| !line.is_empty()) {
            if let Ok(line) = serde_json::from_slice::<Line<'_>>(line) {
                current.insert(line.stage.into_owned(), line.key);
            }
        }
        Ok(current.into_values().collect())
    }
}

impl History {
    /// Marks the current results as used now: `gc` removes the least recently used first. A read-only store is not an error.
    pub fn touch(&self) {
        let _ = fsx::touch(&self.path);
    }

    /// The keys of a stage, latest first.
    pub fn earlier(&self, stage: &str) -> impl Iterator<Item = &Key> {
        self.stages.get(stage).into_iter().flatten().rev()
    }

    /// The outputs of a key, if they are known here.
    pub fn outputs(&self, key: &Key) -> Option<&Arc<Outputs>> {
        self.outputs.get(key)
    }

    /// Adds the current key of a stage, unless it is the latest already.
    pub fn note(&mut self, stage: &str, key: Key, outputs: &Arc<Outputs>) -> Result<(), StoreError> {
        if self.earlier(stage).next() == Some(&key) {
            return Ok(());
        }
        self.insert(stage, key, Arc::clone(outputs));
        self.lines += 1;
        push_line(&mut self.unwritten, stage, key, outputs);
        self.gathered += 1;
        if self.gathered >= BATCH { self.flush() } else { Ok(()) }
    }

    /// Writes the gathered lines.
    pub fn flush(&mut self) -> Result<(), StoreError> {
        if self.gathered > 0 {
            match (fsx::append(&self.path, &self.unwritten), self.path.parent()) {
                (Err(error), Some(folder)) if error.is_not_found() => {
                    fsx::create_dir_all(folder)?;
                    fsx::append(&self.path, &self.unwritten)?;
                }
                (result, _) => result?,
            }
            self.unwritten.clear();
            self.gathered = 0;
        }
        Ok(())
    }

    /// Keeps only the last line of each stage, if most lines are outdated.
    pub fn compact(&mut self) -> Result<(), StoreError> {
        self.flush()?;
        if self.lines <= 2 * self.stages.len() + BATCH {
            return Ok(());
        }
        let mut bytes = Vec::new();
        let mut stages: Vec<_> = self.stages.iter().collect();
        stages.sort();
        for (stage, keys) in stages {
            if let Some((key, outputs)) = keys.last().and_then(|key| self.outputs.get_key_value(key)) {
                push_line(&mut bytes, stage, *key, outputs);
            }
        }
        self.lines = self.stages.len();
        Ok(fsx::write_atomic(&self.path, &bytes)?)
    }

    fn insert(&mut self, stage: &str, key: Key, outputs: Arc<Outputs>) {
        match self.stages.get_mut(stage) {
            Some(keys) => keys.push(key),
            None => drop(self.stages.insert(stage.to_owned(), vec![key])),
        }
        self.outputs.insert(key, outputs);
    }
}

fn push_line(bytes: &mut Vec<u8>, stage: &str, key: Key, outputs: &Outputs) {
    let start = bytes.len();
    let line = Line { stage: Cow::Borrowed(stage), key, outputs: Cow::Borrowed(outputs) };
    // Only strings, digests and whole numbers: this cannot fail.
    if serde_json::to_writer(&mut *bytes, &line).is_err() {
        bytes.truncate(start);
    } else {
        bytes.push(b'\n');
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn key(number: u8) -> Key {
        Key::new([number; 32])
    }

    fn stages(store: &Store) -> usize {
        store.history("p", "q").unwrap().stages.len()
    }

    #[test]
    fn keys_are_read_back_latest_first() {
        let folder = tempfile::tempdir().unwrap();
        let store = Store::open(folder.path()).unwrap();
        let mut history = store.history("p", "q").unwrap();
        for number in [1, 2, 2, 1] {
            history.note("a", key(number), &Arc::default()).unwrap();
        }
        history.flush().unwrap();
        let read = store.history("p", "q").unwrap();
        assert_eq!(read.earlier("a").copied().collect::<Vec<_>>(), [key(1), key(2), key(1)]);
        assert_eq!(read.earlier("b").count(), 0);
        assert!(read.outputs(&key(2)).is_some());
        assert_eq!(store.history("p", "other").unwrap().lines, 0);
    }

    #[test]
    fn a_history_of_version_1_stays_readable() {
        let golden = include_str!("../../tests/golden/history-v1.jsonl");
        let folder = tempfile::tempdir().unwrap();
        let store = Store::open(folder.path()).unwrap();
        let mut written = store.history("p", "q").unwrap();
        fsx::create_dir_all(written.path.parent().unwrap()).unwrap();
        fsx::write(&written.path, golden.as_bytes()).unwrap();
        let read = store.history("p", "q").unwrap();
        assert_eq!(read.lines, 3);
        assert_eq!(read.earlier("clone[policy=beta]").copied().collect::<Vec<_>>(), [key(6), key(1)]);
        let outputs = read.outputs(&key(3)).unwrap();
        assert_eq!(
            (outputs["csv"].bytes, outputs["md"].digest),
            (u64::MAX, crate::store::Digest::new([5; 32]))
        );
        fsx::remove_file(&written.path).unwrap();
        for (stage, number) in [("clone[policy=beta]", 1), ("table ü", 3), ("clone[policy=beta]", 6)] {
            written.note(stage, key(number), read.outputs(&key(number)).unwrap()).unwrap();
        }
        written.flush().unwrap();
        assert_eq!(fsx::read(&written.path).unwrap(), golden.as_bytes());
    }

    #[test]
    fn a_torn_line_costs_only_itself() {
        let folder = tempfile::tempdir().unwrap();
        let store = Store::open(folder.path()).unwrap();
        let mut history = store.history("p", "q").unwrap();
        history.note("a", key(1), &Arc::default()).unwrap();
        history.flush().unwrap();
        fsx::append(&history.path, b"{\"stage\":\"b\",\"ke").unwrap();
        assert_eq!(stages(&store), 1);
        fsx::append(&history.path, b"\n\xff\xfe\n\n").unwrap();
        let mut history = store.history("p", "q").unwrap();
        history.note("c", key(3), &Arc::default()).unwrap();
        history.flush().unwrap();
        assert_eq!(stages(&store), 2);
    }

    #[test]
    fn compaction_keeps_the_last_line_of_each_stage() {
        let folder = tempfile::tempdir().unwrap();
        let store = Store::open(folder.path()).unwrap();
        let mut history = store.history("p", "q").unwrap();
        for round in 0..100 {
            for stage in ["a", "b"] {
                history.note(stage, key(round), &Arc::default()).unwrap();
            }
        }
        history.compact().unwrap();
        let read = store.history("p", "q").unwrap();
        assert_eq!(read.lines, 2);
        assert_eq!(read.earlier("b").next(), Some(&key(99)));
    }
}
