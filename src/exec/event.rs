//! What happens during a run. One closed enum: the dispatcher alone owns the state and tells; printers listen.

use std::time::Duration;

use dril_stage_api::Progress;

use crate::plan::Reason;
use crate::resolve::StageIndex;
use crate::store::Key;

/// Something that happened.
#[derive(Debug, Clone)]
pub enum Event {
    /// The run begins: stages in all, of these certainly cached, threads to use.
    Started {
        /// All stages of the goal.
        stages: usize,
        /// Stages that can run side by side, counted in threads.
        threads: usize,
    },
    /// Nothing to do: the record is there.
    Cached {
        /// Which.
        stage: StageIndex,
        /// Its key.
        key: Key,
    },
    /// Another process builds this key; waiting for it.
    Waiting {
        /// Which.
        stage: StageIndex,
    },
    /// The stage's process was started.
    StageStarted {
        /// Which.
        stage: StageIndex,
        /// Its key.
        key: Key,
        /// Why it runs.
        why: Vec<Reason>,
    },
    /// How far it is.
    Progressed {
        /// Which.
        stage: StageIndex,
        /// How far.
        progress: Progress,
    },
    /// It finished and its outputs are published.
    StageFinished {
        /// Which.
        stage: StageIndex,
        /// How long it took.
        took: Duration,
    },
    /// It failed.
    StageFailed {
        /// Which.
        stage: StageIndex,
        /// The error, one or more lines.
        error: String,
        /// What sort of failure it is.
        cause: Cause,
        /// The last lines of its log.
        log_tail: Vec<String>,
        /// The full log.
        log: std::path::PathBuf,
    },
    /// It failed and will be tried again.
    Retrying {
        /// Which.
        stage: StageIndex,
        /// The number of the new try, from 1.
        retry: u32,
        /// How many new tries there are.
        of: u32,
        /// Why the last one failed.
        error: String,
        /// How long until the new one begins.
        pause: Duration,
    },
    /// It cannot run because a stage before it failed.
    Skipped {
        /// Which.
        stage: StageIndex,
        /// The stage that failed.
        because: StageIndex,
    },
    /// The run was asked to stop, or its time is over; running stages are being stopped.
    Stopping {
        /// True where its time is over.
        out_of_time: bool,
    },
    /// A stage stopped cleanly on request, and will go on from its checkpoint.
    Stopped {
        /// Which.
        stage: StageIndex,
    },
    /// The run ended.
    Finished {
        /// The counts.
        outcome: Outcome,
    },
}

/// Why a stage failed.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Cause {
    /// By its own fault.
    Failed,
    /// It took more memory than it may, or than there is.
    Memory,
    /// It took longer than it may.
    Timeout,
    /// The store failed it.
    Store,
}

impl Cause {
    /// Its name in JSON.
    pub fn name(self) -> &'static str {
        match self {
            Self::Failed => "failed",
            Self::Memory => "memory",
            Self::Timeout => "timeout",
            Self::Store => "store",
        }
    }
}

/// How a run ended.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub struct Outcome {
    /// Stages whose record was there.
    pub cached: usize,
    /// Stages that ran and finished.
    pub ran: usize,
    /// Stages that failed.
    pub failed: usize,
    /// Stages that could not run because one before them failed.
    pub skipped: usize,
    /// Stages that were stopped or never started because the run was asked to stop.
    pub stopped: usize,
    /// True where the run stopped because its time was over.
    pub out_of_time: bool,
    /// Wall time.
    pub took: Duration,
}

impl Outcome {
    /// True where every stage of the goal is done.
    pub fn is_complete(&self) -> bool {
        self.failed == 0 && self.skipped == 0 && self.stopped == 0
    }
}
