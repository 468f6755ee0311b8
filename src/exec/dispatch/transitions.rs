//! State transitions: what happens to a stage and to the stages downstream once it is built, found in the store, failed or
//! stopped.

use std::sync::Arc;
use std::time::Duration;

use super::{Dispatcher, State, TAIL_LINES, TAIL_WIDTH};
use crate::exec::event::Event;
use crate::exec::failure::Failure;
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
            self.found(twin, key, Arc::clone(&outputs))?;
        }
        Ok(())
    }

    pub(super) fn not_built(&mut self, stage: StageIndex, failure: Failure, twins: &[StageIndex]) {
        self.failed(stage, failure);
        self.skip_readers(stage, stage);
        for &twin in twins {
            self.skip(twin, stage);
            self.skip_readers(twin, stage);
        }
    }

    pub(super) fn stopped(&mut self, stage: StageIndex) {
        self.state[stage.index()] = State::Over;
        self.outcome.stopped += 1;
        self.journal.emit(&Event::Stopped { stage });
    }

    pub(super) fn committed(
        &mut self,
        stage: StageIndex,
        committed: Result<Duration, StoreError>,
    ) -> Result<(), StoreError> {
        self.committing -= 1;
        if let Some(key) = &self.keys[stage.index()] {
            self.underway.remove(key);
        }
        match committed {
            Ok(took) => {
                self.outcome.ran += 1;
                self.journal.emit(&Event::StageFinished { stage, took });
                self.record_in_history(stage)
            }
            // Its outputs can be used, so stages downstream run; but it has no record.
            Err(error) => {
                self.failed(stage, error.into());
                Ok(())
            }
        }
    }

    pub(super) fn failed(&mut self, stage: StageIndex, failure: Failure) {
        self.state[stage.index()] = State::Over;
        self.outcome.failed += 1;
        if !self.context.options.keep_going {
            self.halted.get_or_insert(stage);
        }
        let log = self.journal.run().map(|run| run.log(&self.log_name(stage))).unwrap_or_default();
        let log_tail = match crate::fsx::tail(&log, TAIL_LINES, TAIL_WIDTH) {
            Err(error) if !error.is_not_found() => vec![format!("({error})")],
            tail => tail.unwrap_or_default(),
        };
        let failure = Arc::new(failure);
        self.journal.emit(&Event::StageFailed { stage, failure, log_tail, log });
    }

    /// Skips all stages downstream of `stage`, because `because` failed.
    pub(super) fn skip_readers(&mut self, stage: StageIndex, because: StageIndex) {
        let mut behind = vec![stage];
        while let Some(stage) = behind.pop() {
            for &reader in self.context.order.readers(stage) {
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
        self.journal.emit(&Event::Skipped { stage, because });
    }

    /// A stage whose outputs turn out to exist: done without running, and stages downstream may be done, too.
    pub(super) fn found(
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
        self.journal.emit(&Event::Cached { stage, key });
        self.record_in_history(stage)
    }

    /// Visits the stages downstream of one that is done: their keys can be known now, and cache hits are done, too.
    pub(super) fn wake_readers(&mut self, stage: StageIndex) -> Result<(), StoreError> {
        let mut done = vec![stage];
        while let Some(stage) = done.pop() {
            for &reader in self.context.order.readers(stage) {
                self.left[reader.index()] -= 1;
                if self.left[reader.index()] > 0 || self.state[reader.index()] != State::Pending {
                    continue;
                }
                match plan::key_of(&self.context.graph.stages[reader], &self.done, self.context.files) {
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
                        self.failed(reader, error.into());
                        self.skip_readers(reader, reader);
                    }
                }
            }
        }
        Ok(())
    }
}
