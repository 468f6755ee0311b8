//! What the engine needs from a scheduler: to submit jobs, to list them, and to stop some. `commands` calls Slurm,
//! `template` other schedulers, and the tests have a simulated cluster.

use std::collections::BTreeMap;
use std::path::PathBuf;
use std::time::Duration;

/// The ID of a job, as the scheduler prints it.
pub type JobId = String;

/// A job to submit.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Submission {
    /// A name that no other job has, so that a job whose submission got no answer can be found.
    pub name: String,
    /// The script that the job runs.
    pub script: PathBuf,
    /// The job's folder: its working directory, and the place of its output.
    pub folder: PathBuf,
    /// Threads that it needs.
    pub threads: usize,
    /// Bytes of memory that it needs; `None` for the partition's default.
    pub memory: Option<u64>,
    /// How long it may run; `None` for the partition's default.
    pub time: Option<Duration>,
    /// How long before the end of `time` it gets the signal to stop.
    pub signal: Duration,
    /// GPUs that it needs.
    pub gpus: usize,
    /// The partition or queue; `None` for the default.
    pub partition: Option<String>,
    /// The account that is charged; `None` for the default.
    pub account: Option<String>,
    /// The quality of service; `None` for the default.
    pub qos: Option<String>,
    /// Further arguments of the submission command.
    pub extra: Vec<String>,
}

/// Why a job was not submitted.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum SubmitError {
    /// The scheduler cannot accept it now: it is busy or does not answer, or there are too many jobs. It may have accepted
    /// the job nevertheless.
    #[error("{0}")]
    Busy(String),
    /// The scheduler will never accept it.
    #[error("{0}")]
    Refused(String),
    /// The message means neither for certain.
    #[error("{0}")]
    Unclear(String),
}

/// A job in the scheduler's list.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Seen {
    /// Its state.
    pub state: State,
    /// The node that it runs on or ran on; empty where there is none.
    pub node: String,
}

/// The state of a job.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum State {
    /// It waits to be started, or started again.
    Waiting,
    /// It runs, or is about to begin or to end.
    Running,
    /// It is over; the scheduler's name of the state, as `COMPLETED` or `NODE_FAIL`.
    Over(String),
}

/// A scheduler. Calls may take seconds.
pub trait Scheduler: Send + Sync {
    /// Its name in messages, as `Slurm`.
    fn name(&self) -> &str;

    /// How the shell of a job finds the job's ID, where that is not `$SLURM_JOB_ID`.
    fn job_in_shell(&self) -> Option<String> {
        None
    }

    /// True where it sends SIGUSR1 to the script of a job [`Submission::signal`] before the end of its time. Otherwise the
    /// script has a timer.
    fn signals_before_the_end(&self) -> bool {
        true
    }

    /// Checks that it can be used at all.
    ///
    /// # Errors
    /// What is missing, and how to fix it.
    fn check(&self) -> Result<(), String>;

    /// Submits a job.
    ///
    /// # Errors
    /// See [`SubmitError`].
    fn submit(&self, submission: &Submission) -> Result<JobId, SubmitError>;

    /// All jobs of this user in the scheduler's list: those that wait and run, and those that ended lately.
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

    /// Makes running jobs save a checkpoint and stop, and cancels those that wait.
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
