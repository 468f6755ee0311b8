//! A cache of the digests of files from outside, so that an unchanged file is not read again.
//!
//! An entry is valid only while all metadata of the file is the same, and only if the file was at rest when it was hashed: a
//! change right after hashing can leave size and times the same, since the clock of a file system is coarse. So a file that was
//! modified less than [`REST`] before is hashed again next time (git calls this "racily clean"). If the cache is lost or damaged,
//! this costs time, never a result.

use std::collections::HashMap;
use std::os::unix::ffi::OsStrExt;
use std::path::{Path, PathBuf};
use std::time::{SystemTime, UNIX_EPOCH};

use serde::{Deserialize, Serialize};

use super::{Digest, Store, StoreError};
use crate::fsx::{self, Stat};

/// The coarsest clock of a file system in use: FAT has a resolution of two seconds.
const REST: i64 = 2_000_000_000;
/// The maximum number of entries.
const MOST: usize = 500_000;
/// Less work than this is not cached, so that small pipelines do not write a file that changes with every edit.
const WORTH: (usize, u64) = (64, 1 << 20);

/// The files of a store's pipelines, by absolute path.
#[derive(Debug, Default)]
pub struct Stats {
    known: HashMap<PathBuf, Entry>,
    /// Files and bytes that were hashed since the cache was read.
    learned: (usize, u64),
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
struct Entry {
    stat: Stat,
    /// When hashing began, in nanoseconds since 1970.
    hashed: i64,
    digest: Digest,
}

/// An entry as stored: one JSON list per line.
#[derive(Serialize, Deserialize)]
struct Line<'a>(#[serde(borrow)] std::borrow::Cow<'a, str>, u64, u64, u64, i64, i64, bool, i64, Digest);

/// Now, in nanoseconds since 1970.
pub(crate) fn now() -> i64 {
    let now = SystemTime::now().duration_since(UNIX_EPOCH).unwrap_or_default();
    i64::try_from(now.as_nanos()).unwrap_or(i64::MAX)
}

impl Store {
    /// Reads the cache; an empty one where there is none or it cannot be read.
    pub fn stats(&self) -> Stats {
        let bytes = fsx::read_if_there(&self.stats_path()).ok().flatten().unwrap_or_default();
        let mut stats = Stats::default();
        for line in bytes.split(|byte| *byte == b'\n').filter(|line| !line.is_empty()) {
            if let Ok(Line(path, device, inode, bytes, modified, changed, executable, hashed, digest)) =
                serde_json::from_slice(line)
            {
                let stat = Stat { device, inode, bytes, modified, changed, executable };
                stats.known.insert(PathBuf::from(path.into_owned()), Entry { stat, hashed, digest });
            }
        }
        stats
    }

    /// Writes new entries, if hashing them was enough work.
    pub fn keep_stats(&self, stats: &Stats) -> Result<(), StoreError> {
        if stats.learned.0 < WORTH.0 && stats.learned.1 < WORTH.1 {
            return Ok(());
        }
        // Another process may have added entries; of two, the later one is right.
        let mut all = self.stats().known;
        for (path, entry) in &stats.known {
            match all.get(path) {
                Some(other) if other.hashed > entry.hashed => {}
                _ => drop(all.insert(path.clone(), *entry)),
            }
        }
        let mut entries: Vec<(&PathBuf, &Entry)> = all.iter().collect();
        entries.sort_by_key(|(path, entry)| (std::cmp::Reverse(entry.hashed), path.as_os_str().as_bytes()));
        entries.truncate(MOST);
        let mut bytes = Vec::new();
        for (path, Entry { stat, hashed, digest }) in entries {
            // A path that is not UTF-8 is not cached.
            let Some(path) = path.to_str() else { continue };
            let Stat { device, inode, bytes: size, modified, changed, executable } = *stat;
            let line =
                Line(path.into(), device, inode, size, modified, changed, executable, *hashed, *digest);
            if serde_json::to_writer(&mut bytes, &line).is_ok() {
                bytes.push(b'\n');
            }
        }
        let path = self.stats_path();
        if let Some(folder) = path.parent() {
            fsx::create_dir_all(folder)?;
        }
        Ok(fsx::write_atomic(&path, &bytes)?)
    }

    fn stats_path(&self) -> PathBuf {
        self.root().join("stats-v1").join("outside.jsonl")
    }
}

impl Stats {
    /// The digest of a file whose metadata has not changed since it was hashed.
    pub fn digest(&self, path: &Path, stat: &Stat) -> Option<Digest> {
        let entry = self.known.get(path).filter(|entry| entry.stat == *stat)?;
        let touched = stat.modified.max(stat.changed);
        (touched.saturating_add(REST) < entry.hashed).then_some(entry.digest)
    }

    /// Adds the digest of a file that was hashed from `hashed` on, with the same metadata before and after.
    pub fn learn(&mut self, path: &Path, stat: Stat, hashed: i64, digest: Digest) {
        self.known.insert(path.to_owned(), Entry { stat, hashed, digest });
        self.learned.0 += 1;
        self.learned.1 = self.learned.1.saturating_add(stat.bytes);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const STAT: Stat =
        Stat { device: 1, inode: 2, bytes: 1 << 21, modified: 1_000, changed: 2_000, executable: false };
    const LATER: i64 = 2_000 + REST + 1;

    fn learned(hashed: i64) -> Stats {
        let mut stats = Stats::default();
        stats.learn(Path::new("/data/a b"), STAT, hashed, Digest::of(b"a"));
        stats
    }

    #[test]
    fn a_file_counts_as_known_only_if_it_was_at_rest_when_it_was_hashed() {
        let path = Path::new("/data/a b");
        assert_eq!(learned(LATER).digest(path, &STAT), Some(Digest::of(b"a")));
        // Racily clean: a write after hashing could have left the same times.
        assert_eq!(learned(LATER - 1).digest(path, &STAT), None);
        assert_eq!(learned(2_000).digest(path, &STAT), None);
        assert_eq!(learned(0).digest(path, &STAT), None, "a clock that jumped");
    }

    #[test]
    fn any_change_of_what_the_file_system_says_makes_a_file_unknown() {
        let stats = learned(LATER);
        let path = Path::new("/data/a b");
        for other in [
            Stat { device: 9, ..STAT },
            Stat { inode: 9, ..STAT },
            Stat { bytes: 9, ..STAT },
            Stat { modified: 9, ..STAT },
            Stat { changed: 1_999, ..STAT },
            Stat { executable: true, ..STAT },
        ] {
            assert_eq!(stats.digest(path, &other), None, "{other:?}");
        }
        assert_eq!(stats.digest(Path::new("/data/b"), &STAT), None);
    }

    #[test]
    fn what_was_learned_is_read_back_and_small_work_is_not_written() {
        let folder = tempfile::tempdir().unwrap();
        let store = Store::open(&folder.path().join("store")).unwrap();
        let mut small = Stats::default();
        small.learn(Path::new("/data/a b"), Stat { bytes: 10, ..STAT }, LATER, Digest::of(b"a"));
        store.keep_stats(&small).unwrap();
        assert!(!store.root().exists());
        store.keep_stats(&learned(LATER)).unwrap();
        assert_eq!(store.stats().known, learned(LATER).known);
        store.keep_stats(&learned(LATER - 1)).unwrap();
        assert_eq!(store.stats().known, learned(LATER).known, "the later one stays");
        fsx::append(&store.stats_path(), b"[\"torn").unwrap();
        assert_eq!(store.stats().known.len(), 1);
    }
}
