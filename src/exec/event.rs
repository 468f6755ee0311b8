//! Events of a run. One closed enum: only the dispatcher emits them, and reporters listen.

use std::sync::Arc;
use std::time::Duration;

use dril_stage_api::Progress;

use super::failure::Failure;
use crate::plan::Reason;
use crate::resolve::StageIndex;
use crate::store::Key;

/// An event of a run.
#[derive(Debug, Clone)]
pub enum Event {
    /// The run begins.
    Started {
        /// Number of stages in the goal.
        stages: usize,
        /// Threads that running stages may keep busy.
        threads: usize,
    },
    /// Cache hit: the stage's record and outputs exist.
    Cached {
        /// The stage.
        stage: StageIndex,
        /// Its key.
        key: Key,
    },
    /// Another process is building this key; the run waits for it.
    Waiting {
        /// The stage.
        stage: StageIndex,
    },
    /// The stage's process was started.
    StageStarted {
        /// The stage.
        stage: StageIndex,
        /// Its key.
        key: Key,
        /// Why it runs.
        why: Vec<Reason>,
    },
    /// The stage reported its progress.
    Progressed {
        /// The stage.
        stage: StageIndex,
        /// Its progress.
        progress: Progress,
    },
    /// It finished, and its outputs are in the store.
    StageFinished {
        /// The stage.
        stage: StageIndex,
        /// How long it took.
        took: Duration,
    },
    /// It failed.
    StageFailed {
        /// The stage.
        stage: StageIndex,
        /// Why.
        failure: Arc<Failure>,
        /// The last lines of its log; a note in parentheses where the log cannot be read.
        log_tail: Vec<String>,
        /// The path of the full log.
        log: std::path::PathBuf,
    },
    /// It failed and will be retried.
    Retrying {
        /// The stage.
        stage: StageIndex,
        /// The number of the retry, from 1.
        retry: u32,
        /// The number of retries that it has.
        of: u32,
        /// Why the last try failed.
        failure: Arc<Failure>,
        /// The pause before the retry.
        pause: Duration,
    },
    /// It cannot run because a stage upstream failed.
    Skipped {
        /// The stage.
        stage: StageIndex,
        /// The stage that failed.
        because: StageIndex,
    },
    /// The run was asked to stop, or its time is up; running stages are being stopped.
    Stopping {
        /// True where the time is up.
        out_of_time: bool,
    },
    /// A stage stopped on request; the next run resumes it from its checkpoint.
    Stopped {
        /// The stage.
        stage: StageIndex,
    },
    /// The run ended.
    Finished {
        /// The counts.
        outcome: RunOutcome,
    },
}

/// The counts of a run.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub struct RunOutcome {
    /// Cache hits.
    pub cached: usize,
    /// Stages that ran and finished.
    pub ran: usize,
    /// Stages that failed.
    pub failed: usize,
    /// Stages that could not run because a stage upstream failed.
    pub skipped: usize,
    /// Stages that were stopped, or never started, because the run was asked to stop.
    pub stopped: usize,
    /// True where the run stopped because its time was up.
    pub out_of_time: bool,
    /// Wall time.
    pub took: Duration,
}

impl RunOutcome {
    /// True where every stage of the goal is up to date.
    pub fn is_complete(&self) -> bool {
        self.failed == 0 && self.skipped == 0 && self.stopped == 0
    }
}
