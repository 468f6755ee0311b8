//! What the engine asks of a scheduler: to submit a job, which jobs it knows, and to stop some. `commands` asks Slurm
//! itself; the tests have a simulated cluster.

use std::collections::BTreeMap;
use std::path::PathBuf;
use std::time::Duration;

/// A scheduler's number of a job, as it prints it.
pub type JobId = String;

/// A job to submit.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Submission {
    /// A name that no other job has, so that a job whose submission was not acknowledged can be found.
    pub name: String,
    /// The script.
    pub script: PathBuf,
    /// The job's folder, which it begins in, and into which its output goes.
    pub folder: PathBuf,
    /// Threads that it needs.
    pub threads: usize,
    /// Bytes of memory that it needs; `None` for the partition's default.
    pub memory: Option<u64>,
    /// How long it may run; `None` for the partition's default.
    pub time: Option<Duration>,
    /// How long before the end of `time` it is asked to stop.
    pub signal: Duration,
    /// GPUs that it needs.
    pub gpus: usize,
    /// `--partition`, `--account` and `--qos`, and further words, each as one argument.
    pub words: Vec<String>,
}

/// Why a job was not submitted.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum SubmitError {
    /// The scheduler cannot take it now: it is busy or does not answer, or there are too many jobs. The job may have been
    /// taken nevertheless.
    #[error("{0}")]
    Busy(String),
    /// The scheduler will never take it.
    #[error("{0}")]
    Refused(String),
}

/// What the scheduler says of a job.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Seen {
    /// How it stands.
    pub state: State,
    /// The node that it runs on or ran on; empty where there is none.
    pub node: String,
}

/// How a job stands.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum State {
    /// It waits, also for being started again.
    Waiting,
    /// It runs, or is about to begin or to end.
    Running,
    /// It is over; the scheduler's word for how, as `COMPLETED` or `NODE_FAIL`.
    Over(String),
}

/// A scheduler. Calls may take seconds.
pub trait Scheduler: Send + Sync {
    /// Says whether it can be used at all.
    ///
    /// # Errors
    /// What is missing, and how to fix it.
    fn check(&self) -> Result<(), String>;

    /// Submits a job.
    ///
    /// # Errors
    /// See [`SubmitError`].
    fn submit(&self, submission: &Submission) -> Result<JobId, SubmitError>;

    /// All jobs of this user that the scheduler knows: those that wait and run, and those that ended lately.
    ///
    /// # Errors
    /// It does not answer.
    fn list(&self) -> Result<BTreeMap<JobId, Seen>, String>;

    /// One job, also where it is no longer in the list; `None` where the scheduler does not know it.
    ///
    /// # Errors
    /// It does not answer.
    fn look(&self, job: &JobId) -> Result<Option<Seen>, String>;

    /// The job of that name, if there is one.
    ///
    /// # Errors
    /// It does not answer.
    fn find(&self, name: &str) -> Result<Option<JobId>, String>;

    /// Asks running jobs to save a checkpoint and stop, and cancels those that wait.
    ///
    /// # Errors
    /// It does not answer.
    fn stop(&self, jobs: &[JobId]) -> Result<(), String>;

    /// Cancels jobs.
    ///
    /// # Errors
    /// It does not answer.
    fn cancel(&self, jobs: &[JobId]) -> Result<(), String>;
}
