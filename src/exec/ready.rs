//! Stages that could start now, those on the longest path first; and stages whose key another process is building.

use std::cmp::Ordering;
use std::collections::BinaryHeap;
use std::time::{Duration, Instant};

use crate::resolve::StageIndex;

/// Shortest and longest interval between two tries for a lock that another process holds.
const PAUSES: (Duration, Duration) = (Duration::from_millis(2), Duration::from_millis(250));

/// The queue of stages that can start.
#[derive(Debug, Default)]
pub(super) struct Ready(BinaryHeap<Entry>);

#[derive(Debug)]
struct Entry {
    cost: f64,
    stage: StageIndex,
}

impl Ord for Entry {
    fn cmp(&self, other: &Self) -> Ordering {
        self.cost.total_cmp(&other.cost).then_with(|| other.stage.cmp(&self.stage))
    }
}

impl PartialOrd for Entry {
    fn partial_cmp(&self, other: &Self) -> Option<Ordering> {
        Some(self.cmp(other))
    }
}

impl PartialEq for Entry {
    fn eq(&self, other: &Self) -> bool {
        self.cmp(other).is_eq()
    }
}

impl Eq for Entry {}

impl Ready {
    /// Adds a stage with the cost of the longest path that begins with it.
    pub fn push(&mut self, stage: StageIndex, cost: f64) {
        self.0.push(Entry { cost, stage });
    }

    /// The stage to start next: the one with the highest cost, and of equal ones the first in node order.
    pub fn peek(&self) -> Option<StageIndex> {
        self.0.peek().map(|entry| entry.stage)
    }

    /// Removes the stages for which `stays` is false.
    pub fn retain(&mut self, stays: impl Fn(StageIndex) -> bool) {
        self.0.retain(|entry| stays(entry.stage));
    }

    /// Takes the stage to start next.
    pub fn pop(&mut self) -> Option<StageIndex> {
        self.0.pop().map(|entry| entry.stage)
    }
}

impl Ready {
    /// Takes the first of the next `depth` stages for which `fits` is true; the others stay.
    pub fn take_first(&mut self, depth: usize, fits: impl Fn(StageIndex) -> bool) -> Option<StageIndex> {
        let mut passed = Vec::new();
        let mut found = None;
        while found.is_none() && passed.len() < depth {
            let Some(entry) = self.0.pop() else { break };
            if fits(entry.stage) { found = Some(entry.stage) } else { passed.push(entry) }
        }
        self.0.extend(passed);
        found
    }
}

/// Stages whose key another process is building, each with the time of the next try.
#[derive(Debug, Default)]
pub(super) struct LockWaits(Vec<Try>);

#[derive(Debug)]
struct Try {
    stage: StageIndex,
    pause: Duration,
    next: Instant,
    due: bool,
}

impl LockWaits {
    /// Records a failed try; true where it was the stage's first.
    pub fn note(&mut self, stage: StageIndex, now: Instant) -> bool {
        match self.0.iter_mut().find(|entry| entry.stage == stage) {
            Some(entry) => {
                entry.pause = (entry.pause * 2).min(PAUSES.1);
                entry.next = now + entry.pause;
                entry.due = false;
                false
            }
            None => {
                self.0.push(Try { stage, pause: PAUSES.0, next: now + PAUSES.0, due: false });
                true
            }
        }
    }

    /// Removes a stage that no longer waits; true where it did.
    pub fn remove(&mut self, stage: StageIndex) -> bool {
        let before = self.0.len();
        self.0.retain(|entry| entry.stage != stage);
        self.0.len() < before
    }

    /// The stages to try now; each is returned once per [`LockWaits::note`].
    pub fn due(&mut self, now: Instant) -> Vec<StageIndex> {
        let due = self.0.iter_mut().filter(|entry| !entry.due && entry.next <= now);
        due.map(|entry| {
            entry.due = true;
            entry.stage
        })
        .collect()
    }

    /// The time of the next try; `None` where no stage waits.
    pub fn next(&self) -> Option<Instant> {
        self.0.iter().filter(|entry| !entry.due).map(|entry| entry.next).min()
    }

    /// True where no stage waits.
    pub fn is_empty(&self) -> bool {
        self.0.is_empty()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_longest_path_comes_first_and_equal_ones_in_node_order() {
        let mut ready = Ready::default();
        for (stage, cost) in [(3, 1.0), (1, 5.0), (2, 5.0), (0, 0.5)] {
            ready.push(StageIndex::new(stage), cost);
        }
        let order: Vec<usize> = std::iter::from_fn(|| ready.pop()).map(StageIndex::index).collect();
        assert_eq!(order, [1, 2, 3, 0]);
    }

    #[test]
    fn a_waiting_stage_is_tried_at_growing_intervals() {
        let (mut elsewhere, stage, start) = (LockWaits::default(), StageIndex::new(0), Instant::now());
        assert!(elsewhere.note(stage, start));
        assert!(elsewhere.due(start).is_empty());
        let mut now = start;
        let mut pauses = Vec::new();
        for _ in 0..10 {
            let next = elsewhere.next().unwrap();
            pauses.push(next - now);
            now = next;
            assert_eq!(elsewhere.due(now), [stage]);
            assert!(elsewhere.due(now).is_empty() && elsewhere.next().is_none());
            assert!(!elsewhere.note(stage, now));
        }
        assert!(pauses.is_sorted() && pauses[0] == PAUSES.0 && pauses[9] == PAUSES.1, "{pauses:?}");
    }
}
