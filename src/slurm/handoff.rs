//! The files through which engine and node speak. They lie in a folder of the job's own in the store, which every node
//! sees under the same path; each is written beside its place and renamed, so that nobody reads half of one.
//!
//! ```text
//! slurm-v1/<key>/handoff.json   what is to be done
//! slurm-v1/<key>/job.sh         what Slurm starts
//! slurm-v1/<key>/submitted.json the job's name, and its number once Slurm has given one
//! slurm-v1/<key>/claim          the number of the job that runs the stage: made by one, refused to any other
//! slurm-v1/<key>/progress       how far the stage is
//! slurm-v1/<key>/ended.json     how it ended, the last one to be written
//! slurm-v1/ended/<key>          a word to the engine that there is such a file, so that it looks into one folder only
//! ```

use std::path::{Path, PathBuf};
use std::time::Duration;

use dril_stage_api::{Job, Message};
use serde::de::DeserializeOwned;
use serde::{Deserialize, Serialize};

use super::scheduler::JobId;
use crate::exec::Units;
use crate::fsx::{self, FsError};
use crate::spec::Limits;

/// The version of these files.
const VERSION: u32 = 1;

/// What is to be done.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub(super) struct Handoff {
    version: u32,
    /// The version of the engine's program.
    pub tool: String,
    /// The stage, with paths in the job's folder.
    pub job: Job,
    /// Where all goes that the stage prints.
    pub log: PathBuf,
    pub threads: usize,
    pub units: Units,
    timeout: Option<f64>,
    memory: Option<u64>,
    grace: f64,
}

/// The name and number of the job that was submitted last.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub(super) struct Submitted {
    pub name: String,
    /// `None` until Slurm has given one.
    pub job: Option<JobId>,
}

/// How a stage ended on a node.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub(super) struct Ended {
    version: u32,
    pub job: JobId,
    pub node: String,
    pub how: How,
    /// What the stage said that it was made with.
    pub said: Vec<Message>,
}

/// How it ended.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub(super) enum How {
    Done,
    /// It was asked to stop, because the time of its job was nearly over or the run was stopped, and did.
    Stopped,
    Failed(String),
    OutOfMemory(String),
    TimedOut,
}

impl Handoff {
    pub fn new(
        job: Job,
        log: &Path,
        threads: usize,
        units: &Units,
        limits: &Limits,
        grace: Duration,
    ) -> Self {
        Self {
            version: VERSION,
            tool: env!("CARGO_PKG_VERSION").to_owned(),
            job,
            log: log.to_owned(),
            threads,
            units: units.clone(),
            timeout: limits.timeout.map(|time| time.as_secs_f64()),
            memory: limits.memory,
            grace: grace.as_secs_f64(),
        }
    }

    pub fn limits(&self) -> Limits {
        let timeout = self.timeout.and_then(|time| Duration::try_from_secs_f64(time).ok());
        Limits { timeout, memory: self.memory, ..Limits::default() }
    }

    pub fn grace(&self) -> Duration {
        Duration::try_from_secs_f64(self.grace).unwrap_or_default()
    }
}

impl Ended {
    pub fn new(job: JobId, node: String, how: How, said: Vec<Message>) -> Self {
        Self { version: VERSION, job, node, how, said }
    }
}

/// The folder of a job.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(super) struct Home {
    pub folder: PathBuf,
}

impl Home {
    pub fn new(folder: PathBuf) -> Self {
        Self { folder }
    }

    pub fn path(&self, name: &str) -> PathBuf {
        self.folder.join(name)
    }

    /// The file that says to the engine that this job has ended.
    pub fn notice(&self) -> Option<PathBuf> {
        Some(notices(self.folder.parent()?).join(self.folder.file_name()?))
    }

    pub fn write<T: Serialize>(&self, name: &str, value: &T) -> fsx::Result<()> {
        let path = self.path(name);
        let bytes = serde_json::to_vec(value).map_err(|error| FsError {
            action: "write",
            path: path.clone(),
            source: error.into(),
        })?;
        fsx::write_atomic(&path, &bytes)
    }

    /// `None` where there is none, or one that is none of ours.
    pub fn read<T: DeserializeOwned>(&self, name: &str) -> fsx::Result<Option<T>> {
        let bytes = fsx::read_if_there(&self.path(name))?;
        Ok(bytes.and_then(|bytes| serde_json::from_slice(&bytes).ok()))
    }

    /// How the stage ended; `None` while it has not.
    pub fn ended(&self) -> fsx::Result<Option<Ended>> {
        let ended: Option<Ended> = self.read("ended.json")?;
        Ok(ended.filter(|ended| ended.version == VERSION))
    }

    pub fn handoff(&self) -> fsx::Result<Option<Handoff>> {
        let handoff: Option<Handoff> = self.read("handoff.json")?;
        Ok(handoff.filter(|handoff| handoff.version == VERSION))
    }

    /// The job that runs the stage, where one does.
    pub fn claimed_by(&self) -> fsx::Result<Option<JobId>> {
        Ok(fsx::read_if_there(&self.path("claim"))?
            .and_then(|bytes| String::from_utf8(bytes).ok())
            .filter(|job| !job.is_empty()))
    }

    /// Makes room for another job: what an earlier one left is gone, but for what it works with.
    pub fn clear_results(&self) -> fsx::Result<()> {
        for name in ["ended.json", "claim", "progress"] {
            fsx::remove_file(&self.path(name))?;
        }
        if let Some(notice) = self.notice() {
            fsx::remove_file(&notice)?;
        }
        Ok(())
    }
}

/// The folder of the notices, where `jobs` is the folder of all jobs.
pub(super) fn notices(jobs: &Path) -> PathBuf {
    jobs.join("ended")
}
