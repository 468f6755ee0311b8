//! Pauses before retries. A stage that pauses keeps its key and its folder, and leaves its threads and units to others. After the
//! pause it waits for its turn like any stage that can start.

use std::time::{Duration, Instant};

use super::{Dispatcher, State};
use crate::exec::task::Task;
use crate::resolve::StageIndex;

/// A stage that will be tried again.
pub(super) struct Paused<'a> {
    task: Box<Task<'a>>,
    until: Instant,
    /// Its pause is over, and it is in the queue.
    is_due: bool,
}

impl<'a> Dispatcher<'a, '_> {
    /// Puts a stage that failed aside.
    pub(super) fn pause(&mut self, task: Box<Task<'a>>, pause: Duration) {
        let stage = task.stage();
        self.free(stage);
        self.state[stage.index()] = State::Paused;
        self.paused.push(Paused { task, until: Instant::now() + pause, is_due: false });
        if self.stopping {
            self.stop_paused();
        }
    }

    /// Puts the stages whose pause is over into the queue.
    pub(super) fn end_pauses(&mut self) {
        let now = Instant::now();
        for paused in self.paused.iter_mut().filter(|paused| !paused.is_due && paused.until <= now) {
            paused.is_due = true;
            let stage = paused.task.stage();
            self.ready.push(stage, self.costs[stage.index()]);
        }
    }

    /// When the next pause ends.
    pub(super) fn next_try(&self) -> Option<Instant> {
        self.paused.iter().filter(|paused| !paused.is_due).map(|paused| paused.until).min()
    }

    /// The task of a stage that has paused.
    pub(super) fn take_paused(&mut self, stage: StageIndex) -> Option<Task<'a>> {
        let at = self.paused.iter().position(|paused| paused.task.stage() == stage)?;
        Some(*self.paused.swap_remove(at).task)
    }

    /// Removes the stages from the queue that have not begun.
    pub(super) fn keep_begun(&mut self) {
        let state = &self.state;
        self.ready.retain(|stage| state[stage.index()] == State::Paused);
    }

    /// Ends all pauses: the run stops.
    pub(super) fn stop_paused(&mut self) {
        for Paused { task, .. } in std::mem::take(&mut self.paused) {
            let stage = task.stage();
            task.give_up();
            if let Some(key) = self.keys[stage.index()] {
                self.twins.remove(&key);
            }
            self.stopped(stage);
        }
    }
}
