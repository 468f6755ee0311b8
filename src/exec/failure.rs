//! Why a stage has no result. Failures stay typed until they are shown: the command line and the event log call
//! [`std::fmt::Display`], scripts read [`FailureKind::name`].

use std::io;
use std::time::Duration;

use crate::fsx::FsError;
use crate::plan::NoKey;
use crate::store::StoreError;

/// Why a stage has no result.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum Failure {
    /// The stage reported an error, or its process ended without success.
    #[error("{0}")]
    Stage(String),
    /// It was killed because it used more memory than its limit, or because the system ran out of memory.
    #[error("{0}")]
    OutOfMemory(String),
    /// It ran longer than its `timeout`.
    #[error("it ran longer than its `timeout` of {} s", .0.as_secs_f64())]
    TimedOut(Duration),
    /// It ended with success and did not write an output.
    #[error("output `{0}` was not written")]
    MissingOutput(String),
    /// An output is not of the declared type.
    #[error("output `{output}` {seen}, expected a {expected}")]
    WrongOutput {
        /// The output.
        output: String,
        /// What was found, as `is a folder`.
        seen: &'static str,
        /// `file` or `folder`.
        expected: &'static str,
    },
    /// It changed its own copy of an input; the text lists the files.
    #[error(
        "the command changed its input {0}: inputs are read-only; only this stage's own copy was changed, and no other \
         stage sees it. Let the command work on a copy of its own"
    )]
    ChangedInputs(String),
    /// An input is missing from the store or damaged there.
    #[error("input `{port}` cannot be read: {source}")]
    Input {
        /// The input.
        port: &'static str,
        /// What the store reports.
        source: StoreError,
    },
    /// The store cannot be read or written.
    #[error(transparent)]
    Store(#[from] StoreError),
    /// The runner could not start or observe the stage.
    #[error("{0}")]
    Runner(#[from] io::Error),
    /// The engine's own thread panicked while it worked on the stage.
    #[error("the engine's worker panicked")]
    Panicked,
    /// Its parameters cannot enter a key.
    #[error(transparent)]
    Key(#[from] NoKey),
}

/// The category of a failure: what decides about retries, and what scripts see as `cause` in the event log.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum FailureKind {
    /// The stage itself failed.
    Failed,
    /// It used too much memory.
    Memory,
    /// It ran too long.
    Timeout,
    /// The store could not be used; trying again does not help.
    Store,
}

impl Failure {
    /// Its category.
    pub fn kind(&self) -> FailureKind {
        match self {
            Self::OutOfMemory(_) => FailureKind::Memory,
            Self::TimedOut(_) => FailureKind::Timeout,
            Self::Store(_) | Self::Input { .. } => FailureKind::Store,
            _ => FailureKind::Failed,
        }
    }
}

impl FailureKind {
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

impl From<FsError> for Failure {
    fn from(error: FsError) -> Self {
        Self::Store(error.into())
    }
}
