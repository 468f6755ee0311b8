//! The files through which engine and node communicate. They lie in the job's own folder in the store, which every node
//! sees under the same path. Each is written to a temporary file and renamed, so that nobody reads an incomplete one.
//!
//! ```text
//! slurm-v1/<key>/handoff.json   what is to be done
//! slurm-v1/<key>/environment.json variables of the run for the stage's program; only the user may read it
//! slurm-v1/<key>/job.sh         what the scheduler starts
//! slurm-v1/<key>/submitted.json the job's name, and its ID once the scheduler has returned one
//! slurm-v1/<key>/claim          the ID of the job that runs the stage; the first job to create it wins
//! slurm-v1/<key>/progress       how far the stage is
//! slurm-v1/<key>/ended.json     how it ended; written last
//! slurm-v1/ended/<key>          a notice that `ended.json` exists, so that the engine polls one folder only
//! ```
//!
//! `queue` has the files of pilots.

use std::collections::BTreeMap;
use std::ffi::OsString;
use std::path::{Path, PathBuf};
use std::time::Duration;

use dril_stage_api::{Job, Message};
use serde::de::DeserializeOwned;
use serde::{Deserialize, Serialize};

use super::build::Build;
use super::scheduler::JobId;
use crate::exec::Units;
use crate::fsx::{self, FsError};
use crate::spec::Limits;

/// The name of the file with environment variables.
const ENVIRONMENT: &str = "environment.json";
/// The version of these files.
const VERSION: u32 = 1;

/// What is to be done.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub(super) struct Handoff {
    version: u32,
    /// The version of the engine's program.
    pub tool: String,
    /// The builds of the programs that run the stage.
    #[serde(default)]
    pub build: Build,
    /// The stage, with paths in the job's folder.
    pub job: Job,
    /// The file for everything that the stage prints.
    pub log: PathBuf,
    pub threads: usize,
    pub units: Units,
    timeout: Option<f64>,
    memory: Option<u64>,
    grace: f64,
    /// Seconds after which a job of its own stops by itself.
    #[serde(default)]
    pub stop_after: Option<f64>,
}

/// The name and number of the job that was submitted last.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub(super) struct Submitted {
    pub name: String,
    /// `None` until the scheduler has returned one.
    pub job: Option<JobId>,
}

/// How a stage ended on a node.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub(super) struct Ended {
    version: u32,
    pub job: JobId,
    pub node: String,
    pub how: How,
    /// The versions that the stage reported.
    pub messages: Vec<Message>,
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
    /// The pilot that ran it is gone, by this state of its job. An engine writes this.
    Lost(String),
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
            build: Build::new(),
            job,
            log: log.to_owned(),
            threads,
            units: units.clone(),
            timeout: limits.timeout.map(|time| time.as_secs_f64()),
            memory: limits.memory,
            grace: grace.as_secs_f64(),
            stop_after: None,
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
    pub fn new(job: JobId, node: String, how: How, messages: Vec<Message>) -> Self {
        Self { version: VERSION, job, node, how, messages }
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

    /// The file that notifies the engine of the end of this job.
    pub fn notice(&self) -> Option<PathBuf> {
        Some(notices(self.folder.parent()?).join(self.folder.file_name()?))
    }

    /// Writes a file at once as a whole. It need not survive a power failure: the job does not either.
    pub fn write<T: Serialize>(&self, name: &str, value: &T) -> fsx::Result<()> {
        let path = self.path(name);
        let new = self.path(&format!(".{name}-{}", std::process::id()));
        fsx::write(&new, &bytes(&path, value)?)?;
        fsx::rename(&new, &path)
    }

    /// As [`Self::write`], and durable: for what is needed to find a job again after the engine's machine failed.
    pub fn write_synced<T: Serialize>(&self, name: &str, value: &T) -> fsx::Result<()> {
        let path = self.path(name);
        fsx::write_atomic(&path, &bytes(&path, value)?)
    }

    /// `None` where there is none, or it has another format.
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

    /// Keeps environment variables for the stage's program. They may be secrets.
    pub fn keep_environment(&self, variables: &BTreeMap<String, OsString>) -> fsx::Result<()> {
        let path = self.path(ENVIRONMENT);
        let new = self.path(&format!(".{ENVIRONMENT}-{}", std::process::id()));
        fsx::write_private(&new, &bytes(&path, variables)?)?;
        fsx::rename(&new, &path)
    }

    /// What [`Self::keep_environment`] kept.
    pub fn environment(&self) -> fsx::Result<BTreeMap<String, OsString>> {
        Ok(self.read(ENVIRONMENT)?.unwrap_or_default())
    }

    /// The job that runs the stage, where one does.
    pub fn claimed_by(&self) -> fsx::Result<Option<JobId>> {
        Ok(fsx::read_if_there(&self.path("claim"))?
            .and_then(|bytes| String::from_utf8(bytes).ok())
            .filter(|job| !job.is_empty()))
    }

    /// Removes the traces of an earlier job before another one is submitted; what the stage works with stays.
    /// Allows another job to run the stage.
    pub fn release(&self) -> fsx::Result<()> {
        fsx::remove_file(&self.path("claim")).map(drop)
    }

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

fn bytes<T: Serialize>(path: &Path, value: &T) -> fsx::Result<Vec<u8>> {
    serde_json::to_vec(value).map_err(|error| FsError {
        action: "write",
        path: path.to_owned(),
        source: error.into(),
    })
}
