//! The folders of a run: one with manifest, events and logs, and a private one for unfinished work. The private folder of a run
//! that died is removed by the next one.

use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicUsize, Ordering};
use std::time::{SystemTime, UNIX_EPOCH};

use serde_json::Value;

use super::{Store, StoreError};
use crate::fsx::{self, FsError, Lock};

/// Folders that a run needs; those for blobs and records are created when needed.
const FOLDERS: [&str; 3] = ["locks-v1", "checkpoints-v1", "tmp"];

/// The number of small folders that are removed at the end of the run instead of at once, and their maximum size in bytes.
const LEFT: (usize, u64) = (2_000, 64 << 10);

/// A current run.
#[derive(Debug)]
pub struct Run {
    folder: PathBuf,
    temporary: PathBuf,
    lock: Option<Lock>,
    /// Folders that are left for the end of the run.
    left: AtomicUsize,
}

impl Store {
    /// Begins a run: creates its folders, writes its manifest, and removes what dead runs left behind.
    pub fn begin_run(&self, manifest: &Value) -> Result<Run, StoreError> {
        if self.root().to_str().is_none() {
            return Err(StoreError::NotText(self.root().to_owned()));
        }
        for folder in FOLDERS {
            fsx::create_dir_all(&self.root().join(folder))?;
        }
        let id = run_id(SystemTime::now().duration_since(UNIX_EPOCH).unwrap_or_default(), std::process::id());
        let tmp = self.root().join("tmp");
        let temporary = tmp.join(&id);
        // Creating and removing private folders needs the gate: otherwise a new folder could be mistaken for a dead one before
        // its lock exists.
        let gate = Lock::acquire(&tmp.join("gate"))?;
        let _ = remove_dead(&tmp);
        let lock = Lock::try_acquire_run(&lock_path(&temporary))?;
        fsx::create_dir(&temporary)?;
        drop(gate);
        // After the lock: `gc` on another machine takes a run without one for dead.
        let folder = self.root().join("runs-v1").join(&id);
        fsx::create_dir_all(&folder.join("logs"))?;
        fsx::write(&folder.join("run.json"), manifest.to_string().as_bytes())?;
        // Taking the lock in shared mode creates its file, so that `gc` can take it exclusively.
        fsx::open_append(&self.root().join("gc.lock"))?;
        Ok(Run { folder, temporary, lock, left: AtomicUsize::new(0) })
    }
}

impl Run {
    /// Its permanent folder: `run.json`, `events.jsonl`, `logs/`.
    pub fn folder(&self) -> &Path {
        &self.folder
    }

    /// Its private folder, which is removed at the end of the run.
    pub fn temporary(&self) -> &Path {
        &self.temporary
    }

    /// The path of a stage's log; characters of `stem` that file names cannot have are replaced.
    pub fn log(&self, stem: &str) -> PathBuf {
        let name: String = stem
            .chars()
            .map(|c| if c.is_alphanumeric() || "._-".contains(c) { c } else { '_' })
            .take(60)
            .collect();
        self.folder.join("logs").join(format!("{name}.log"))
    }

    /// Removes a folder in the private one that is no longer needed: at once or, if it is small, at the end of the run. Some file
    /// systems skip recently freed inodes when they create a file (ext4 does, for some seconds), so many removals during a run
    /// would make every stage slower than the one before.
    pub fn clear(&self, folder: &Path) {
        let small = self.left.load(Ordering::Relaxed) < LEFT.0 && fsx::holds_at_most(folder, LEFT.1);
        if small {
            self.left.fetch_add(1, Ordering::Relaxed);
        } else {
            // What cannot be removed now is removed with the run's folder.
            let _ = fsx::remove_dir_all(folder);
        }
    }

    /// Appends lines to the run's event log.
    pub fn append_events(&self, lines: &[u8]) -> Result<(), StoreError> {
        Ok(fsx::append(&self.folder.join("events.jsonl"), lines)?)
    }
}

impl Drop for Run {
    fn drop(&mut self) {
        // What cannot be removed now is removed by the next run.
        if fsx::remove_dir_all(&self.temporary).is_ok()
            && let Some(lock) = self.lock.take()
        {
            let _ = lock.remove();
        }
    }
}

fn lock_path(temporary: &Path) -> PathBuf {
    let mut path = temporary.as_os_str().to_owned();
    path.push(".lock");
    path.into()
}

/// Removes private folders of dead runs and the short links to them, and returns what went wrong. This can fail for another user's folder, or while a dying
/// stage still writes; the next run tries again. The caller has the gate.
pub(super) fn remove_dead(tmp: &Path) -> Vec<FsError> {
    let failed = remove_dead_folders(tmp);
    // Those of stages lead to what was just removed.
    fsx::remove_dead_links();
    failed
}

fn remove_dead_folders(tmp: &Path) -> Vec<FsError> {
    let mut failed = Vec::new();
    let Ok(entries) = fsx::list(tmp) else { return failed };
    let owner = |path: &Path| path.file_name()?.to_str()?.split('.').next().map(str::to_owned);
    // The files of one owner follow each other.
    for files in entries.chunk_by(|one, other| owner(one) == owner(other)) {
        let Some(owner) = owner(&files[0]).filter(|owner| !owner.is_empty() && owner != "gate") else {
            continue;
        };
        let folder = tmp.join(owner);
        let Ok(Some(lock)) = Lock::try_acquire(&lock_path(&folder)) else { continue };
        match fsx::remove_dir_all(&folder) {
            Ok(()) => remove_lock(lock, files),
            Err(error) => failed.push(error),
        }
    }
    failed
}

/// Removes a lock whose owner is dead, with the files of processes that died while they took it over.
pub(super) fn remove_lock(lock: Lock, files: &[PathBuf]) {
    let taken_over = |file: &&PathBuf| file.to_string_lossy().contains(".lease.");
    for file in files.iter().filter(taken_over) {
        let _ = fsx::remove_file(file);
    }
    let _ = lock.remove();
}

/// A name that sorts by time: `20261122-034512-123456789-4711` (UTC, nanoseconds, process).
fn run_id(since_1970: std::time::Duration, process: u32) -> String {
    let seconds = since_1970.as_secs();
    let (year, month, day) = civil(seconds / 86_400);
    let (hour, minute, second) = (seconds / 3600 % 24, seconds / 60 % 60, seconds % 60);
    let nanos = since_1970.subsec_nanos();
    format!("{year:04}{month:02}{day:02}-{hour:02}{minute:02}{second:02}-{nanos:09}-{process}")
}

/// The time since 1970 in a name of [`run_id`]; `None` for any other text.
pub(super) fn begun_at(id: &str) -> Option<std::time::Duration> {
    let mut parts = id.split('-');
    let (date, time, nanos, process) = (parts.next()?, parts.next()?, parts.next()?, parts.next()?);
    let digits = |text: &str, length| text.len() == length && text.bytes().all(|byte| byte.is_ascii_digit());
    if !digits(date, 8) || !digits(time, 6) || !digits(nanos, 9) || !digits(process, process.len().max(1)) {
        return None;
    }
    let number = |text: &str| text.parse::<u64>().ok();
    let (year, month, day) = (number(&date[..4])?, number(&date[4..6])?, number(&date[6..])?);
    let (hour, minute, second) = (number(&time[..2])?, number(&time[2..4])?, number(&time[4..])?);
    let shifted = if month > 2 { year } else { year.checked_sub(1)? };
    let (era, year_of_era) = (shifted / 400, shifted % 400);
    let day_of_year = (153 * ((month + 9) % 12) + 2) / 5 + day.checked_sub(1)?;
    let days = (era * 146_097 + year_of_era * 365 + year_of_era / 4 - year_of_era / 100 + day_of_year)
        .checked_sub(719_468)?;
    let seconds = days * 86_400 + hour * 3600 + minute * 60 + second;
    Some(std::time::Duration::new(seconds, u32::try_from(number(nanos)?).ok()?))
}

/// Year, month and day of a day counted from 1970-01-01 (H. Hinnant, "chrono-compatible low-level date algorithms").
pub(super) fn civil(days: u64) -> (u64, u64, u64) {
    let shifted = days + 719_468;
    let (era, day_of_era) = (shifted / 146_097, shifted % 146_097);
    let year_of_era = (day_of_era - day_of_era / 1460 + day_of_era / 36_524 - day_of_era / 146_096) / 365;
    let day_of_year = day_of_era - (365 * year_of_era + year_of_era / 4 - year_of_era / 100);
    let month_from_march = (5 * day_of_year + 2) / 153;
    let day = day_of_year - (153 * month_from_march + 2) / 5 + 1;
    let month = if month_from_march < 10 { month_from_march + 3 } else { month_from_march - 9 };
    (era * 400 + year_of_era + u64::from(month <= 2), month, day)
}

#[cfg(test)]
mod tests {
    use std::time::Duration;

    use super::*;

    #[test]
    fn run_names_carry_the_date_in_utc() {
        for (seconds, start) in [
            (0, "19700101-000000-000000000-7"),
            (951_782_400, "20000229-000000-"),
            (1_709_210_096, "20240229-123456-"),
            (1_798_761_599, "20261231-235959-"),
        ] {
            let id = run_id(Duration::from_secs(seconds), 7);
            assert!(id.starts_with(start), "{id}");
            assert_eq!(begun_at(&id), Some(Duration::from_secs(seconds)), "{id}");
        }
        for wrong in ["", "last", "20260101", "2026xx01-000000-000000000-1", "20260101-000000-000000000-"] {
            assert_eq!(begun_at(wrong), None, "{wrong}");
        }
    }

    #[test]
    fn a_new_run_removes_the_folders_of_dead_runs_and_not_of_living_ones() {
        let folder = tempfile::tempdir().unwrap();
        let store = Store::open(folder.path()).unwrap();
        let living = store.begin_run(&Value::Null).unwrap();
        let dead = folder.path().join("tmp/20200101-000000-000000000-1");
        fsx::create_dir_all(&dead.join("half")).unwrap();
        fsx::write(&lock_path(&dead), b"").unwrap();
        let next = store.begin_run(&Value::Null).unwrap();
        assert_eq!(fsx::entry(&dead).unwrap(), None);
        assert_eq!(fsx::entry(&lock_path(&dead)).unwrap(), None);
        assert_eq!(fsx::entry(living.temporary()).unwrap(), Some(fsx::Entry::Folder));
        drop((living, next));
        assert_eq!(fsx::list(&folder.path().join("tmp")).unwrap(), [folder.path().join("tmp/gate")]);
    }
}
