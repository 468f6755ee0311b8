//! Failures in past runs: whether the last try of a stage failed, and why.

use std::collections::HashMap;

use crate::error::Error;
use crate::plan::{Plan, Verdict};
use crate::store::{Key, StageState, Store};

/// The number of past runs that are searched.
const RUNS: usize = 20;

/// What became of the latest try of stages, by key.
#[derive(Debug, Default)]
pub(in crate::cli) struct Failures {
    /// The message of one that failed; `None` where it did not.
    messages: HashMap<Key, Option<String>>,
}

impl Failures {
    /// The failures in the latest runs of the plan's pipeline and profile.
    pub(in crate::cli) fn of(plan: &Plan<'_>, store: &Store) -> Result<Self, Error> {
        let mut failures = Self::default();
        if plan.steps.iter().all(|(_, verdict)| matches!(verdict, Verdict::Cached { .. })) {
            return Ok(failures);
        }
        for id in store.run_ids()?.into_iter().take(RUNS) {
            let run = store.past_run(&id)?;
            if run.pipeline != plan.graph.pipeline || run.profile != plan.graph.profile {
                continue;
            }
            for stage in run.stages.into_values().filter(|stage| stage.fate.was_started()) {
                let message = (stage.fate == StageState::Failed).then(|| stage.error.unwrap_or_default());
                if let Some(key) = stage.key {
                    failures.messages.entry(key).or_insert(message);
                }
            }
        }
        Ok(failures)
    }

    /// Why the latest try of this key failed; `None` where it did not.
    pub(in crate::cli) fn message(&self, key: &Key) -> Option<&str> {
        self.messages.get(key)?.as_deref()
    }
}
