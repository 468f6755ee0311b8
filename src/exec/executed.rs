//! The outcome of a run: its counts, the outputs of every finished stage, and the errors that end a run early.

use std::path::PathBuf;
use std::sync::Arc;

use super::event::RunOutcome;
use super::resources::InsufficientResource;
use crate::resolve::StageIndex;
use crate::store::{Hold, Key, Outputs, Run, StoreError};

/// The outcome of a run.
#[derive(Clone, Debug, Default)]
pub struct Executed {
    /// The counts.
    pub outcome: RunOutcome,
    /// The outputs of every finished stage, by node index; `None` for the others.
    pub outputs: Vec<Option<Arc<Outputs>>>,
    /// The run's folder with its manifest, events and logs; `None` where nothing had to run.
    pub folder: Option<PathBuf>,
    /// The key of every finished stage, by node index.
    pub keys: Vec<Option<Key>>,
    /// Protects the outputs from `gc` while this value exists.
    pub(super) _kept: Kept,
}

/// What protects the outputs of a run from `gc`: its list of what it relies on or, where nothing ran, the lock.
#[derive(Clone, Debug, Default)]
pub(super) struct Kept {
    pub _run: Option<Arc<Run>>,
    pub _held: Option<Arc<Hold>>,
}

impl Executed {
    /// The outputs of a finished stage.
    pub fn outputs(&self, stage: StageIndex) -> Option<&Outputs> {
        self.outputs.get(stage.index())?.as_deref()
    }
}

/// Why a run could not start or continue. A failing stage is not one of these errors: it is reported as an event.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum ExecError {
    /// The store cannot be read or written.
    #[error(transparent)]
    Store(#[from] StoreError),
    /// The runner cannot run stages of a kind that the plan needs.
    #[error("stages of kind `{kind}` cannot run: {source}")]
    Worker {
        /// The first such kind.
        kind: &'static str,
        /// What is missing.
        source: Box<dyn std::error::Error + Send + Sync>,
    },
    /// A stage asks for more units of a resource than the run has.
    #[error(transparent)]
    InsufficientResource(#[from] InsufficientResource),
}
