//! Submits jobs one after the other, with patience: a scheduler that is busy, restarts or does not answer is tried again for
//! an hour, and a job that it accepted without an answer is found by its name.

use std::sync::atomic::{AtomicUsize, Ordering};
use std::sync::{Arc, Mutex, PoisonError};
use std::time::{Duration, Instant};

use super::handoff::{Home, Submitted};
use super::scheduler::{JobId, Scheduler, Submission, SubmitError};
use crate::exec::Failure;

/// How soon a request to stop is noticed.
pub(super) const WAIT: Duration = Duration::from_millis(250);
/// How long a scheduler may be busy or away until a submission fails.
const PATIENCE: Duration = Duration::from_secs(3600);
/// How long an attempt is repeated whose error means nothing certain.
const DOUBT: Duration = Duration::from_secs(120);
/// The longest pause between two attempts.
const LONGEST_PAUSE: Duration = Duration::from_secs(30);

/// Submits the jobs of an engine.
pub(super) struct Submitter {
    pub scheduler: Arc<dyn Scheduler>,
    /// One submission at a time: schedulers throttle users who submit many at once.
    one: Mutex<()>,
    number: AtomicUsize,
}

impl Submitter {
    pub fn new(scheduler: Arc<dyn Scheduler>) -> Self {
        Self { scheduler, one: Mutex::new(()), number: AtomicUsize::new(0) }
    }

    /// A name that no other job has.
    pub fn name(&self, about: &str) -> String {
        let number = self.number.fetch_add(1, Ordering::Relaxed);
        let about: String = about.chars().take(12).collect();
        format!("dril-{about}-{}-{number}", std::process::id())
    }

    /// Submits a job; `None` where the run was stopped meanwhile.
    ///
    /// # Errors
    /// The scheduler refuses it, or is busy or away for an hour, or the job's folder cannot be written.
    pub fn submit(
        &self,
        home: &Home,
        submission: &Submission,
        stopping: &dyn Fn() -> bool,
    ) -> Result<Option<JobId>, Failure> {
        let name = submission.name.clone();
        home.write_synced("submitted.json", &Submitted { name: name.clone(), job: None })?;
        let (began, mut pause) = (Instant::now(), Duration::from_secs(1));
        let job = loop {
            if stopping() {
                return Ok(None);
            }
            let answer = {
                let _one = self.one.lock().unwrap_or_else(PoisonError::into_inner);
                self.scheduler.submit(submission)
            };
            match answer {
                Ok(job) => break job,
                Err(SubmitError::Refused(error)) => return Err(self.refused(&error)),
                Err(SubmitError::Unclear(error)) if began.elapsed() > DOUBT => {
                    return Err(self.refused(&error));
                }
                Err(SubmitError::Busy(error)) if began.elapsed() > PATIENCE => {
                    return Err(self.unreachable(&error));
                }
                Err(SubmitError::Busy(_) | SubmitError::Unclear(_)) => {}
            }
            if !sleep(pause, stopping) {
                return Ok(None);
            }
            pause = (pause * 2).min(LONGEST_PAUSE);
            // It may have been accepted, and only the answer was lost.
            if let Ok(Some(job)) = self.scheduler.find(&name) {
                break job;
            }
        };
        home.write_synced("submitted.json", &Submitted { name, job: Some(job.clone()) })?;
        Ok(Some(job))
    }

    /// The job of that name, if there is one; a scheduler that does not answer is tried again.
    pub fn find(&self, name: &str) -> Result<Option<JobId>, Failure> {
        let began = Instant::now();
        loop {
            match self.scheduler.find(name) {
                Ok(job) => return Ok(job),
                Err(error) if began.elapsed() > PATIENCE => return Err(self.unreachable(&error)),
                Err(_) => std::thread::sleep(Duration::from_secs(1)),
            }
        }
    }

    fn refused(&self, error: &str) -> Failure {
        Failure::Stage(format!("{} refuses its job: {error}", self.scheduler.name()))
    }

    fn unreachable(&self, error: &str) -> Failure {
        Failure::Stage(format!("{} accepted no job for an hour: {error}", self.scheduler.name()))
    }
}

/// False where the run was stopped meanwhile.
fn sleep(time: Duration, stopping: &dyn Fn() -> bool) -> bool {
    let end = Instant::now() + time;
    while Instant::now() < end {
        if stopping() {
            return false;
        }
        std::thread::sleep(WAIT.min(end.saturating_duration_since(Instant::now())));
    }
    true
}
