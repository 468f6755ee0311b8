//! Garbage collection: removes old results, checkpoints of finished stages, logs and leftovers. What a running process uses is
//! never removed.

use std::collections::{HashMap, HashSet};
use std::io::ErrorKind;
use std::path::{Path, PathBuf};
use std::time::{Duration, SystemTime, UNIX_EPOCH};

use super::run::{begun_at, remove_dead, remove_lock};
use super::usage::measure;
use super::{Digest, InUse, Key, Record, Store, StoreError};
use crate::fsx::{self, Entry, Lock};

/// What to remove.
#[derive(Clone, Debug, Default)]
pub struct Sweep {
    /// Keys whose results are kept.
    pub keep: HashSet<Key>,
    /// Removes results that were not used for this long, and checkpoints, logs and quarantined files of that age.
    pub older_than: Option<Duration>,
    /// Then removes the least recently used results, checkpoints and logs until they and the inputs of results are at most this
    /// many bytes. The folders of jobs are counted, too.
    pub max_bytes: Option<u64>,
    /// Removes nothing, and only reports.
    pub dry_run: bool,
}

/// What was removed, or would be.
#[derive(Clone, Debug, Default)]
pub struct Swept {
    /// Results: key, the stage that built it, and when it was last used.
    pub records: Vec<(Key, String, SystemTime)>,
    /// Blobs.
    pub blobs: usize,
    /// Folders of checkpoints.
    pub checkpoints: usize,
    /// Folders of jobs of a cluster that nobody waits for.
    pub jobs: usize,
    /// Folders of runs, with their logs.
    pub runs: usize,
    /// Freed bytes.
    pub freed: u64,
    /// Bytes of remaining blobs.
    pub left: u64,
    /// Results that would have been removed, but a running process uses them.
    pub in_use: usize,
    /// What could not be removed because it belongs to another user, each with the reason.
    pub not_removed: Vec<(PathBuf, String)>,
    /// True where more than the maximum size remains, because all of it is kept or in use.
    pub too_much: bool,
}

/// A result, with what matters here.
struct Result_ {
    key: Key,
    record: Record,
    /// Bytes of the record itself.
    bytes: u64,
    /// All blobs of its outputs.
    contents: Vec<Digest>,
    used: SystemTime,
    goes: bool,
}

/// What takes room besides blobs.
#[derive(Default)]
struct Beside {
    /// Bytes of what stays: it is in use, or belongs to a job.
    fixed: u64,
    /// Checkpoints, logs and quarantined files: when they were used, and their bytes.
    loose: Vec<(SystemTime, u64)>,
}

impl Beside {
    fn add(&mut self, stays: bool, time: Option<SystemTime>, path: &Path) -> fsx::Result<()> {
        let bytes = measure(path)?.bytes;
        match time.filter(|_| !stays) {
            Some(time) => self.loose.push((time, bytes)),
            None => self.fixed += bytes,
        }
        Ok(())
    }
}

impl Store {
    /// All valid records.
    pub fn records(&self) -> Result<Vec<(Key, Record)>, StoreError> {
        let mut all = Vec::new();
        for (_, name) in self.sharded_files("records-v1")? {
            let Some(key) = name.strip_suffix(".json").and_then(|key| key.parse::<Key>().ok()) else {
                continue;
            };
            if let Some(record) = self.record(&key)? {
                all.push((key, record));
            }
        }
        Ok(all)
    }

    /// Collects garbage. Current runs continue; they only wait where they look results up.
    ///
    /// # Errors
    /// The store cannot be read or written; what was removed until then stays removed.
    pub fn sweep(&self, wish: &Sweep) -> Result<Swept, StoreError> {
        if fsx::entry(self.root())?.is_none() {
            return Ok(Swept::default());
        }
        let (_held, _alone) =
            if wish.dry_run { (self.hold()?, None) } else { (None, Some(self.hold_alone()?)) };
        let not_removed = if wish.dry_run { Vec::new() } else { self.sweep_dead()? };
        // Before the current ones are read: what is new afterwards is not in the list.
        let runs = self.run_ids()?;
        let in_use = self.in_use()?;
        let mut results = self.results()?;
        let mut swept = Swept { not_removed, ..Swept::default() };
        let sizes = self.blob_sizes()?;
        let beside = match wish.max_bytes {
            Some(_) => self.beside(&in_use, &results, &runs)?,
            None => Beside::default(),
        };
        let before = choose(wish, &in_use, &mut results, &sizes, beside, &mut swept);
        for result in results.iter().filter(|result| result.goes) {
            if !wish.dry_run {
                fsx::remove_file(&self.record_path(&result.key))?;
            }
            swept.records.push((result.key, result.record.stage.clone(), result.used));
        }
        self.sweep_blobs(wish, &in_use, &results, &sizes, &mut swept)?;
        self.sweep_jobs(wish, &in_use, &results, &mut swept)?;
        self.sweep_rest((wish, before), &in_use, (&results, &runs), &mut swept)?;
        Ok(swept)
    }

    /// When results were last found by a run. Every run touches the history file of its pipeline, so its current results count as
    /// used then; a run in which nothing changed touches the list of its results, which need not be the latest in the history.
    fn last_uses(&self) -> Result<HashMap<Key, SystemTime>, StoreError> {
        let mut used: HashMap<Key, SystemTime> = HashMap::new();
        let mut note = |key, time: SystemTime| {
            let last = used.entry(key).or_insert(time);
            *last = time.max(*last);
        };
        for path in fsx::list(&self.root().join("history-v1"))? {
            let Some(time) = fsx::modified(&path)? else { continue };
            self.current_keys(&path)?.into_iter().for_each(|key| note(key, time));
        }
        for run in self.complete_runs()? {
            run.keys.into_iter().for_each(|key| note(key, run.used));
        }
        Ok(used)
    }

    /// Every result with the time of its last use, least recently used first.
    fn results(&self) -> Result<Vec<Result_>, StoreError> {
        let used = self.last_uses()?;
        let mut results = Vec::new();
        for (key, record) in self.records()? {
            let made = self.made_at(&key)?.unwrap_or(UNIX_EPOCH);
            let used = used.get(&key).map_or(made, |used| made.max(*used));
            let mut contents = Vec::new();
            for stored in record.outputs.values() {
                contents.extend(self.contents(stored)?.into_iter().map(|(digest, _)| digest));
            }
            let bytes = measure(&self.record_path(&key))?.bytes;
            results.push(Result_ { key, record, bytes, contents, used, goes: false });
        }
        results.sort_by_key(|result| (result.used, result.key));
        Ok(results)
    }

    fn blob_sizes(&self) -> Result<HashMap<Digest, u64>, StoreError> {
        let mut sizes = HashMap::new();
        for (path, name) in self.sharded_files("blobs-v1")? {
            if let (Ok(digest), Some(Entry::File(bytes))) = (name.parse::<Digest>(), fsx::entry(&path)?) {
                sizes.insert(digest, bytes);
            }
        }
        Ok(sizes)
    }

    /// What there is besides blobs, without what is removed anyway.
    fn beside(&self, in_use: &InUse, results: &[Result_], runs: &[String]) -> Result<Beside, StoreError> {
        let done: HashSet<Key> = results.iter().map(|result| result.key).collect();
        let mut beside = Beside::default();
        for folder in ["checkpoints-v1", "slurm-v1"] {
            for path in fsx::list(&self.root().join(folder))? {
                let key = key_of(&path);
                if key.is_none_or(|key| !done.contains(&key)) {
                    let stays = self.has_job(key)? || key.is_some_and(|key| in_use.keys.contains(&key));
                    beside.add(stays, last_saved(&path)?, &path)?;
                }
            }
        }
        for id in runs {
            let path = self.root().join("runs-v1").join(id);
            beside.add(in_use.runs.contains(id), last_written(&path, id)?, &path)?;
        }
        for path in fsx::list(&self.root().join("quarantine-v1"))? {
            beside.add(false, fsx::modified(&path)?, &path)?;
        }
        Ok(beside)
    }

    /// Removes blobs that no remaining result contains or was made from.
    fn sweep_blobs(
        &self,
        wish: &Sweep,
        in_use: &InUse,
        results: &[Result_],
        sizes: &HashMap<Digest, u64>,
        swept: &mut Swept,
    ) -> Result<(), StoreError> {
        let made: HashSet<Digest> = results.iter().flat_map(|result| &result.contents).copied().collect();
        let mut needed = in_use.digests.clone();
        for result in results.iter().filter(|result| !result.goes || in_use.keys.contains(&result.key)) {
            needed.extend(&result.contents);
            let read = result.record.inputs.iter().flat_map(|input| &input.items).map(|item| item.digest);
            needed.extend(read.filter(|digest| !made.contains(digest)));
        }
        for (digest, bytes) in sizes {
            if needed.contains(digest) {
                swept.left += bytes;
                continue;
            }
            if !wish.dry_run {
                fsx::remove_file(&self.blob_path(digest))?;
            }
            swept.blobs += 1;
            swept.freed += bytes;
        }
        Ok(())
    }

    /// Removes checkpoints, runs and quarantined files up to a time, checkpoints of finished stages, and what is derived from files
    /// that are gone.
    fn sweep_rest(
        &self,
        (wish, before): (&Sweep, Option<SystemTime>),
        in_use: &InUse,
        (results, runs): (&[Result_], &[String]),
        swept: &mut Swept,
    ) -> Result<(), StoreError> {
        let done: HashSet<Key> = results.iter().map(|result| result.key).collect();
        let (dry_run, old) = (wish.dry_run, |time| is_older(before, time));
        for path in fsx::list(&self.root().join("checkpoints-v1"))? {
            let key = key_of(&path);
            let finished = key.is_some_and(|key| done.contains(&key));
            // A job continues without an engine, and is not in use then.
            let before = if self.has_job(key)? { oldest_kept(wish) } else { before };
            if !(finished || before.is_some() && is_older(before, last_saved(&path)?))
                || key.is_some_and(|key| in_use.keys.contains(&key))
            {
                continue;
            }
            // While this is held, nobody begins to build it. The stage of a dead engine may still be dying.
            let lock = match key {
                Some(key) if !dry_run => Some(self.try_lock(&key)?),
                Some(key) if self.is_being_made(&key) => Some(None),
                _ => None,
            };
            if !matches!(lock, Some(None)) && !Lock::is_held(&path.join("lock"))? {
                swept.checkpoints += usize::from(remove(&path, dry_run, swept)?);
            }
            if let Some(Some(lock)) = lock {
                lock.remove()?;
            }
        }
        for id in runs {
            let path = self.root().join("runs-v1").join(id);
            if before.is_some() && !in_use.runs.contains(id) && old(last_written(&path, id)?) {
                swept.runs += usize::from(remove(&path, dry_run, swept)?);
            }
        }
        for path in fsx::list(&self.root().join("quarantine-v1"))? {
            if old(fsx::modified(&path)?) {
                remove(&path, dry_run, swept)?;
            }
        }
        if dry_run { Ok(()) } else { self.sweep_derived((wish, before), swept) }
    }

    /// Removes what only saves time: memos up to a time, and the lists of complete runs whose results are gone.
    fn sweep_derived(
        &self,
        (wish, before): (&Sweep, Option<SystemTime>),
        swept: &Swept,
    ) -> Result<(), StoreError> {
        for path in fsx::list(&self.root().join("parsed-v1"))? {
            if is_older(before, fsx::modified(&path)?) {
                fsx::remove_file(&path)?;
            }
        }
        let removed: HashSet<Key> = swept.records.iter().map(|(key, ..)| *key).collect();
        for run in self.complete_runs()? {
            let is_whole = !run.keys.is_empty() && !run.keys.iter().any(|key| removed.contains(key));
            if !is_whole || is_older(oldest_kept(wish), Some(run.used)) {
                fsx::remove_file(&run.path)?;
            }
        }
        Ok(())
    }

    /// Removes the folders of jobs of a cluster whose stage has a result, or whose last sign of life is too old. Of the others a new run
    /// takes over what their jobs made.
    fn sweep_jobs(
        &self,
        wish: &Sweep,
        in_use: &InUse,
        results: &[Result_],
        swept: &mut Swept,
    ) -> Result<(), StoreError> {
        let done: HashSet<Key> = results.iter().map(|result| result.key).collect();
        let jobs = self.root().join("slurm-v1");
        for path in fsx::list(&jobs)? {
            let key = key_of(&path);
            // Folders with other names belong to all jobs.
            let Some(key) = key.filter(|key| !in_use.keys.contains(key)) else { continue };
            let mut last = fsx::modified(&path)?;
            for file in ["claim", "progress", "ended.json"] {
                last = last.max(fsx::modified(&path.join(file))?);
            }
            if !done.contains(&key) && !is_older(oldest_kept(wish), last)
                || Lock::is_held(&self.checkpoints(&key).join("lock"))?
            {
                continue;
            }
            // An engine that waits for the job has the lock on its key.
            let lock = if wish.dry_run { None } else { Some(self.try_lock(&key)?) };
            if matches!(lock, Some(None)) || wish.dry_run && self.is_being_made(&key) {
                continue;
            }
            if !wish.dry_run {
                fsx::remove_file(&jobs.join("ended").join(key.hex()))?;
            }
            swept.jobs += usize::from(remove(&path, wish.dry_run, swept)?);
            if let Some(Some(lock)) = lock {
                lock.remove()?;
            }
        }
        Ok(())
    }

    /// True where a job of a cluster may work for this key, or where this is none of a stage.
    fn has_job(&self, key: Option<Key>) -> fsx::Result<bool> {
        let Some(key) = key else { return Ok(true) };
        Ok(fsx::entry(&self.root().join("slurm-v1").join(key.hex()))?.is_some())
    }

    /// Removes locks and folders of dead runs; returns what could not be removed, and why. Before the lists of runs are read: a run of another machine that gave no sign of life
    /// for long, and continues later, then finds its folder gone instead of relying on what is removed.
    fn sweep_dead(&self) -> Result<Vec<(PathBuf, String)>, StoreError> {
        let mut failed = Vec::new();
        let tmp = self.root().join("tmp");
        if fsx::entry(&tmp)?.is_some() {
            // That also makes network file systems forget what they know of this folder.
            let _gate = Lock::acquire(&tmp.join("gate"))?;
            failed = remove_dead(&tmp);
        }
        let locks = fsx::list(&self.root().join("locks-v1"))?;
        for files in locks.chunk_by(|one, other| lock_of(one) == lock_of(other)) {
            if let Some(Ok(Some(lock))) = lock_of(&files[0]).map(|path| Lock::try_acquire(&path)) {
                remove_lock(lock, files);
            }
        }
        Ok(failed.into_iter().map(|error| (error.path, error.source.to_string())).collect())
    }
}

/// Decides which results go, by age and then by size. Returns the time up to which what is beside the blobs goes.
fn choose(
    wish: &Sweep,
    in_use: &InUse,
    results: &mut [Result_],
    sizes: &HashMap<Digest, u64>,
    beside: Beside,
    swept: &mut Swept,
) -> Option<SystemTime> {
    enum Item {
        Result(usize),
        Beside(u64),
    }
    let holds = blobs_held(results);
    let mut users: HashMap<Digest, usize> = HashMap::new();
    holds.iter().flatten().for_each(|digest| *users.entry(*digest).or_default() += 1);
    let size = |digest: &Digest| sizes.get(digest).copied().unwrap_or_default();
    let mut total: u64 = users.keys().map(size).sum::<u64>() + beside.fixed;
    total += results
        .iter()
        .map(|result| result.bytes)
        .chain(beside.loose.iter().map(|(_, bytes)| *bytes))
        .sum::<u64>();
    let mut items: Vec<(SystemTime, Item)> =
        results.iter().enumerate().map(|(index, result)| (result.used, Item::Result(index))).collect();
    items.extend(beside.loose.into_iter().map(|(time, bytes)| (time, Item::Beside(bytes))));
    // Of the same moment, a log goes before the results of its run.
    items.sort_by_key(|(time, item)| (*time, matches!(item, Item::Result(_))));
    let oldest = oldest_kept(wish);
    let mut before = oldest;
    for (time, item) in items {
        let old = if matches!(item, Item::Result(_)) { oldest } else { before };
        let goes = is_older(old, Some(time)) || wish.max_bytes.is_some_and(|limit| total > limit);
        match item {
            Item::Beside(bytes) if goes => {
                before = before.max(Some(time));
                total -= bytes;
            }
            Item::Result(index) if goes && !wish.keep.contains(&results[index].key) => {
                if in_use.keys.contains(&results[index].key) {
                    swept.in_use += 1;
                    continue;
                }
                results[index].goes = true;
                total -= results[index].bytes;
                for digest in &holds[index] {
                    if let Some(count) = users.get_mut(digest) {
                        *count = count.saturating_sub(1);
                        if *count == 0 {
                            total -= size(digest);
                        }
                    }
                }
            }
            _ => {}
        }
    }
    swept.too_much = wish.max_bytes.is_some_and(|limit| total > limit);
    before
}

/// The blobs that stay because of each result: its outputs, and the inputs that no other result contains.
fn blobs_held(results: &[Result_]) -> Vec<Vec<Digest>> {
    let made: HashSet<Digest> = results.iter().flat_map(|result| &result.contents).copied().collect();
    let held = |result: &Result_| {
        let read = result.record.inputs.iter().flat_map(|input| &input.items).map(|item| item.digest);
        result.contents.iter().copied().chain(read.filter(|digest| !made.contains(digest))).collect()
    };
    results.iter().map(held).collect()
}

/// The time before which nothing is kept, by its age.
fn oldest_kept(wish: &Sweep) -> Option<SystemTime> {
    Some(SystemTime::now().checked_sub(wish.older_than?).unwrap_or(UNIX_EPOCH))
}

/// True for a time that is not kept.
fn is_older(before: Option<SystemTime>, time: Option<SystemTime>) -> bool {
    before.zip(time).is_some_and(|(before, time)| time <= before)
}

/// The key that a folder is named by.
fn key_of(path: &Path) -> Option<Key> {
    path.file_name()?.to_str()?.parse().ok()
}

/// When a checkpoint was saved last: programs may overwrite it in place.
fn last_saved(path: &Path) -> fsx::Result<Option<SystemTime>> {
    Ok(fsx::newest(&path.join("files"))?.or(fsx::modified(path)?))
}

/// When a run last wrote to its folder; `None` for a folder with another name.
fn last_written(path: &Path, id: &str) -> fsx::Result<Option<SystemTime>> {
    let Some(since) = begun_at(id) else { return Ok(None) };
    Ok(fsx::newest(path)?.max(Some(UNIX_EPOCH + since)))
}

/// The lock that a file in `locks-v1` belongs to: it is named by a key, and what is beside it has an ending.
fn lock_of(file: &Path) -> Option<PathBuf> {
    let name = file.file_name()?.to_str()?;
    Some(file.with_file_name(name.split('.').next().filter(|key| !key.is_empty())?))
}

/// Removes a file or folder. False where that is not permitted: users of a shared cache can only remove what is their own, and
/// the rest must not keep them from that.
fn remove(path: &Path, dry_run: bool, swept: &mut Swept) -> fsx::Result<bool> {
    let bytes = measure(path)?.bytes;
    let removed = match fsx::entry(path)? {
        _ if dry_run => Ok(()),
        Some(Entry::Folder) => fsx::remove_dir_all(path),
        _ => fsx::remove_file(path).map(drop),
    };
    match removed {
        Err(error) if error.source.kind() == ErrorKind::PermissionDenied => {
            swept.not_removed.push((error.path, error.source.to_string()));
            return Ok(false);
        }
        removed => removed?,
    }
    swept.freed += bytes;
    Ok(true)
}
