//! The files through which pilots get stages. Every node and every engine that uses the store sees them under the same path.
//!
//! ```text
//! pilots-v1/queue-<class>/<number>-<key>   a stage that waits for a pilot of this class; the lowest number is first
//! pilots-v1/<name>/pilot.json              what the pilot needs to know
//! pilots-v1/<name>/job.sh                  what the scheduler starts
//! pilots-v1/<name>/submitted.json          the pilot's name, and its job ID once the scheduler has returned one
//! pilots-v1/<name>/job                     its job ID, written by the pilot itself
//! pilots-v1/<name>/taken/<number>-<key>    the stage that it runs
//! pilots-v1/<name>/end                     requests its end as soon as it runs no stage
//! pilots-v1/<name>/ended                   it has ended, and will take no stage again
//! ```
//!
//! A pilot takes a stage by renaming its file, so each stage is taken once.

use std::path::{Path, PathBuf};
use std::time::{SystemTime, UNIX_EPOCH};

use serde::{Deserialize, Serialize};

use super::handoff::{Home, Submitted};
use super::scheduler::JobId;
use crate::fsx;

/// The folder of all pilots and queues in a store.
pub(super) const PILOTS: &str = "pilots-v1";
/// The version of `pilot.json`.
const VERSION: u32 = 1;

/// What a pilot needs to know.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub(super) struct Orders {
    version: u32,
    /// Pilots of one class have the same resources and take stages from the same queue.
    pub class: String,
    /// The folder of all jobs.
    pub jobs: PathBuf,
    /// Seconds without a stage after which it ends.
    pub idle: f64,
    /// Seconds after which it stops by itself.
    pub stop_after: Option<f64>,
}

impl Orders {
    pub fn new(class: String, jobs: PathBuf, idle: f64, stop_after: Option<f64>) -> Self {
        Self { version: VERSION, class, jobs, idle, stop_after }
    }
}

/// A stage in a queue: the name of its file.
#[derive(Clone, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub(super) struct Entry(String);

impl Entry {
    /// The key of the stage, which is the name of its job's folder.
    pub fn key(&self) -> &str {
        self.0.split_once('-').map_or("", |(_, key)| key)
    }
}

/// Since 1970.
fn nanoseconds() -> u128 {
    SystemTime::now().duration_since(UNIX_EPOCH).unwrap_or_default().as_nanos()
}

/// The names of the files in a folder, sorted, without temporary ones.
fn entries(folder: &Path) -> fsx::Result<Vec<Entry>> {
    let names = fsx::list(folder)?.into_iter();
    let names = names.filter_map(|path| Some(path.file_name()?.to_str()?.to_owned()));
    Ok(names.filter(|name| !name.starts_with('.')).map(Entry).collect())
}

/// Stages that wait for pilots of one class.
#[derive(Clone, Debug)]
pub(super) struct Queue {
    folder: PathBuf,
}

impl Queue {
    pub fn new(pilots: &Path, class: &str) -> Self {
        Self { folder: pilots.join(format!("queue-{class}")) }
    }

    pub fn create(&self) -> fsx::Result<()> {
        fsx::create_dir_all(&self.folder)
    }

    /// Appends a stage.
    pub fn put(&self, key: &str) -> fsx::Result<Entry> {
        let entry = Entry(format!("{:020}-{key}", nanoseconds()));
        fsx::write(&self.folder.join(&entry.0), b"")?;
        Ok(entry)
    }

    /// All stages, the first one first.
    pub fn list(&self) -> fsx::Result<Vec<Entry>> {
        entries(&self.folder)
    }

    /// Makes a network file system look again for what is in it.
    pub fn refresh(&self) {
        // It only saves time.
        let _ = fsx::refresh(&self.folder);
    }

    /// Removes a stage; false where a pilot has taken it.
    pub fn withdraw(&self, entry: &Entry) -> fsx::Result<bool> {
        fsx::remove_file(&self.folder.join(&entry.0))
    }
}

/// The folder of a pilot.
#[derive(Clone, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub(super) struct PilotFolder(pub PathBuf);

impl PilotFolder {
    /// All pilots in a store.
    pub fn all(pilots: &Path) -> fsx::Result<Vec<Self>> {
        let is_pilot = |path: &PathBuf| {
            path.file_name().and_then(|name| name.to_str()).is_some_and(|name| name.starts_with("pilot-"))
        };
        Ok(fsx::list(pilots)?.into_iter().filter(is_pilot).map(Self).collect())
    }

    /// A new one, whose name no other has.
    pub fn new(pilots: &Path) -> Self {
        Self(pilots.join(format!("pilot-{}-{}", nanoseconds(), std::process::id())))
    }

    pub fn home(&self) -> Home {
        Home::new(self.0.clone())
    }

    fn taken_folder(&self) -> PathBuf {
        self.0.join("taken")
    }

    pub fn create(&self, orders: &Orders) -> fsx::Result<()> {
        fsx::create_dir_all(&self.taken_folder())?;
        self.home().write("pilot.json", orders)
    }

    /// `None` where it is not there, or of another version.
    pub fn orders(&self) -> fsx::Result<Option<Orders>> {
        let orders: Option<Orders> = self.home().read("pilot.json")?;
        Ok(orders.filter(|orders| orders.version == VERSION))
    }

    /// Its job ID, where that is known.
    pub fn job(&self) -> fsx::Result<Option<JobId>> {
        let own = fsx::read_if_there(&self.0.join("job"))?.and_then(|bytes| String::from_utf8(bytes).ok());
        if let Some(job) = own.filter(|job| !job.is_empty()) {
            return Ok(Some(job));
        }
        Ok(self.home().read::<Submitted>("submitted.json")?.and_then(|submitted| submitted.job))
    }

    /// True where its program ran.
    pub fn has_begun(&self) -> bool {
        fsx::entry(&self.0.join("job")).is_ok_and(|entry| entry.is_some())
    }

    /// Takes a stage from the queue; false where another pilot was faster.
    pub fn take(&self, queue: &Queue, entry: &Entry) -> fsx::Result<bool> {
        let to = self.taken_folder().join(&entry.0);
        match fsx::rename(&queue.folder.join(&entry.0), &to) {
            Ok(()) => Ok(true),
            // A network file system may repeat a request whose answer was lost; then the second one fails.
            Err(error) if error.is_not_found() => Ok(fsx::entry(&to)?.is_some()),
            Err(error) => Err(error),
        }
    }

    /// Returns a stage that it took to the queue, with its old number.
    pub fn give_back(&self, queue: &Queue, entry: &Entry) -> fsx::Result<()> {
        fsx::rename(&self.taken_folder().join(&entry.0), &queue.folder.join(&entry.0))
    }

    /// What it took and has not finished.
    pub fn taken(&self) -> fsx::Result<Vec<Entry>> {
        entries(&self.taken_folder())
    }

    /// The stage is finished.
    pub fn finish(&self, entry: &Entry) -> fsx::Result<()> {
        fsx::remove_file(&self.taken_folder().join(&entry.0)).map(drop)
    }

    /// Asks it to end as soon as it runs no stage.
    pub fn ask_to_end(&self) -> fsx::Result<()> {
        fsx::write(&self.0.join("end"), b"")
    }

    pub fn shall_end(&self) -> fsx::Result<bool> {
        Ok(fsx::entry(&self.0.join("end"))?.is_some())
    }

    /// Notes that it has ended.
    pub fn end(&self) -> fsx::Result<()> {
        fsx::write(&self.0.join("ended"), b"")
    }

    /// True once it has ended, and where its folder is gone.
    pub fn has_ended(&self) -> fsx::Result<bool> {
        let has = |name: &str| Ok(fsx::entry(&self.0.join(name))?.is_some());
        Ok(has("ended")? || !has("pilot.json")?)
    }

    /// Removes the folder of a pilot that has ended.
    pub fn remove(&self) -> fsx::Result<()> {
        self.retire()?.map_or(Ok(()), |aside| fsx::remove_dir_all(&aside.0))
    }

    /// Moves it aside, so that a job that Slurm starts again takes no more stages; `None` where another engine has done so.
    pub fn retire(&self) -> fsx::Result<Option<Self>> {
        let name = self.0.file_name().unwrap_or_default().to_string_lossy().into_owned();
        let aside = self.0.with_file_name(format!("retired-{name}"));
        match fsx::rename(&self.0, &aside) {
            Ok(()) => Ok(Some(Self(aside))),
            Err(error) if error.is_not_found() => Ok(None),
            Err(error) => Err(error),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn of_two_pilots_one_takes_a_stage_and_the_first_in_the_queue_is_first() {
        let root = tempfile::tempdir().unwrap();
        let queue = Queue::new(root.path(), "c");
        queue.create().unwrap();
        let pilots = ["pilot-1", "pilot-2"].map(|name| PilotFolder(root.path().join(name)));
        for pilot in &pilots {
            pilot.create(&Orders::new("c".to_owned(), root.path().to_owned(), 1.0, None)).unwrap();
        }
        let entries = ["b", "a", "c"].map(|key| queue.put(key).unwrap());
        std::fs::write(queue.folder.join(".tmp-1"), "").unwrap();
        assert_eq!(queue.list().unwrap(), entries);
        assert_eq!(entries[0].key(), "b");
        assert!(pilots[0].take(&queue, &entries[0]).unwrap());
        assert!(!pilots[1].take(&queue, &entries[0]).unwrap());
        assert!(pilots[0].take(&queue, &entries[0]).unwrap(), "a repeated request has the same answer");
        assert!(!queue.withdraw(&entries[0]).unwrap());
        assert!(queue.withdraw(&entries[1]).unwrap());
        pilots[0].give_back(&queue, &entries[0]).unwrap();
        assert_eq!(queue.list().unwrap(), [entries[0].clone(), entries[2].clone()]);
        assert_eq!(PilotFolder::all(root.path()).unwrap(), pilots);
    }

    #[test]
    fn a_retired_pilot_can_take_nothing() {
        let root = tempfile::tempdir().unwrap();
        let queue = Queue::new(root.path(), "c");
        queue.create().unwrap();
        let pilot = PilotFolder(root.path().join("pilot-1"));
        pilot.create(&Orders::new("c".to_owned(), root.path().to_owned(), 1.0, None)).unwrap();
        let (first, second) = (queue.put("a").unwrap(), queue.put("b").unwrap());
        assert!(pilot.take(&queue, &first).unwrap());
        let aside = pilot.retire().unwrap().unwrap();
        assert_eq!(aside.taken().unwrap(), [first]);
        assert_eq!(pilot.retire().unwrap(), None);
        assert!(!pilot.take(&queue, &second).unwrap());
        assert_eq!(queue.list().unwrap(), [second]);
        assert_eq!(pilot.orders().unwrap(), None);
    }
}
