//! What becomes of a stage once it is built, failed or found: its readers wake, or are skipped.

use std::sync::Arc;
use std::time::Duration;

use super::{Dispatcher, State, TAIL, TAIL_WIDTH};
use crate::exec::work::Failure;
use crate::exec::{Cause, Event};
use crate::plan::{self, Cached};
use crate::resolve::StageIndex;
use crate::store::{Key, Outputs, StoreError};

impl Dispatcher<'_, '_> {
    pub(super) fn built(
        &mut self,
        stage: StageIndex,
        key: Key,
        outputs: Arc<Outputs>,
        twins: &[StageIndex],
    ) -> Result<(), StoreError> {
        self.committing += 1;
        self.underway.insert(key, Arc::clone(&outputs));
        self.state[stage.index()] = State::Done;
        self.done[stage.index()] = Some(Arc::clone(&outputs));
        self.wake_readers(stage)?;
        for &twin in twins {
            self.settle(twin, key, Arc::clone(&outputs))?;
        }
        Ok(())
    }

    pub(super) fn not_built(&mut self, stage: StageIndex, failure: Failure, twins: &[StageIndex]) {
        match failure {
            Failure::Stopped => {
                self.state[stage.index()] = State::Over;
                self.outcome.stopped += 1;
                self.journal.tell(&Event::Stopped { stage });
            }
            Failure::Failed(error, cause) => {
                self.failed(stage, error, cause);
                self.skip_readers(stage, stage);
                for &twin in twins {
                    self.skip(twin, stage);
                    self.skip_readers(twin, stage);
                }
            }
        }
    }

    pub(super) fn committed(
        &mut self,
        stage: StageIndex,
        committed: Result<Duration, String>,
    ) -> Result<(), StoreError> {
        self.committing -= 1;
        if let Some(key) = &self.keys[stage.index()] {
            self.underway.remove(key);
        }
        match committed {
            Ok(took) => {
                self.outcome.ran += 1;
                self.journal.tell(&Event::StageFinished { stage, took });
                self.note(stage)
            }
            // Its outputs can be used, so what depends on it goes on; but it has no record.
            Err(error) => {
                self.failed(stage, error, Cause::Store);
                Ok(())
            }
        }
    }

    pub(super) fn failed(&mut self, stage: StageIndex, error: String, cause: Cause) {
        self.state[stage.index()] = State::Over;
        self.outcome.failed += 1;
        if !self.site.options.keep_going {
            self.halted.get_or_insert(stage);
        }
        let log = self.journal.run().map(|run| run.log(&self.log_stem(stage))).unwrap_or_default();
        let log_tail = match crate::fsx::tail(&log, TAIL, TAIL_WIDTH) {
            Err(error) if !error.is_not_found() => vec![format!("({error})")],
            tail => tail.unwrap_or_default(),
        };
        self.journal.tell(&Event::StageFailed { stage, error, cause, log_tail, log });
    }

    /// Skips all that can not run because `because` failed.
    pub(super) fn skip_readers(&mut self, stage: StageIndex, because: StageIndex) {
        let mut behind = vec![stage];
        while let Some(stage) = behind.pop() {
            for &reader in self.shape.order.readers(stage) {
                if self.state[reader.index()] == State::Pending {
                    self.skip(reader, because);
                    behind.push(reader);
                }
            }
        }
    }

    pub(super) fn skip(&mut self, stage: StageIndex, because: StageIndex) {
        self.state[stage.index()] = State::Over;
        self.outcome.skipped += 1;
        self.journal.tell(&Event::Skipped { stage, because });
    }

    /// A stage whose outputs are there: done without running, and so may be those behind it.
    pub(super) fn settle(
        &mut self,
        stage: StageIndex,
        key: Key,
        outputs: Arc<Outputs>,
    ) -> Result<(), StoreError> {
        self.cached(stage, key, outputs)?;
        self.wake_readers(stage)
    }

    pub(super) fn cached(
        &mut self,
        stage: StageIndex,
        key: Key,
        outputs: Arc<Outputs>,
    ) -> Result<(), StoreError> {
        self.keys[stage.index()] = Some(key);
        self.state[stage.index()] = State::Done;
        self.done[stage.index()] = Some(outputs);
        self.outcome.cached += 1;
        self.journal.tell(&Event::Cached { stage, key });
        self.note(stage)
    }

    /// Looks at the stages behind one that is done: their keys can now be known, and what is there already is done too.
    pub(super) fn wake_readers(&mut self, stage: StageIndex) -> Result<(), StoreError> {
        let mut done = vec![stage];
        while let Some(stage) = done.pop() {
            for &reader in self.shape.order.readers(stage) {
                self.left[reader.index()] -= 1;
                if self.left[reader.index()] > 0 || self.state[reader.index()] != State::Pending {
                    continue;
                }
                match plan::key_of(&self.shape.graph.stages[reader], &self.done, self.shape.files) {
                    Ok(Some(key)) => match self.look_up(reader, &key)? {
                        Cached::Yes(outputs) => {
                            self.cached(reader, key, outputs)?;
                            done.push(reader);
                        }
                        Cached::No(reason) => {
                            self.why[reader.index()] = reason.map(|reason| vec![reason]);
                            self.make_ready(reader, key);
                        }
                    },
                    Ok(None) => {}
                    Err(error) => {
                        self.failed(reader, error.to_string(), Cause::Failed);
                        self.skip_readers(reader, reader);
                    }
                }
            }
        }
        Ok(())
    }
}
