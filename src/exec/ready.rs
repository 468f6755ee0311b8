//! Stages that could start now, the longest chain of work first; and those that wait for another process.

use std::cmp::Ordering;
use std::collections::BinaryHeap;
use std::time::{Duration, Instant};

use crate::resolve::StageIndex;

/// How soon, and at the latest how rarely, a lock that somebody else holds is tried again.
const PAUSES: (Duration, Duration) = (Duration::from_millis(2), Duration::from_millis(250));

/// The queue.
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
    /// Adds a stage with the cost of the longest chain that begins with it.
    pub fn push(&mut self, stage: StageIndex, cost: f64) {
        self.0.push(Entry { cost, stage });
    }

    /// The stage to start next: of the highest cost, of several the first in node order.
    pub fn peek(&self) -> Option<StageIndex> {
        self.0.peek().map(|entry| entry.stage)
    }

    /// Takes it.
    pub fn pop(&mut self) -> Option<StageIndex> {
        self.0.pop().map(|entry| entry.stage)
    }
}

impl Ready {
    /// Takes the first of the next `depth` stages that `fits`; the others stay.
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

/// Stages whose key another process holds, each with the time of its next try.
#[derive(Debug, Default)]
pub(super) struct Elsewhere(Vec<Try>);

#[derive(Debug)]
struct Try {
    stage: StageIndex,
    pause: Duration,
    next: Instant,
    due: bool,
}

impl Elsewhere {
    /// Notes a try that failed; true where it was the stage's first.
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

    /// Forgets a stage that waits no longer.
    pub fn remove(&mut self, stage: StageIndex) {
        self.0.retain(|entry| entry.stage != stage);
    }

    /// The stages to try now; each is given once per [`Elsewhere::note`].
    pub fn due(&mut self, now: Instant) -> Vec<StageIndex> {
        let due = self.0.iter_mut().filter(|entry| !entry.due && entry.next <= now);
        due.map(|entry| {
            entry.due = true;
            entry.stage
        })
        .collect()
    }

    /// The time of the next try, `None` where nobody waits.
    pub fn next(&self) -> Option<Instant> {
        self.0.iter().filter(|entry| !entry.due).map(|entry| entry.next).min()
    }

    /// True where nobody waits.
    pub fn is_empty(&self) -> bool {
        self.0.is_empty()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_longest_chain_comes_first_and_equal_ones_in_node_order() {
        let mut ready = Ready::default();
        for (stage, cost) in [(3, 1.0), (1, 5.0), (2, 5.0), (0, 0.5)] {
            ready.push(StageIndex::new(stage), cost);
        }
        let order: Vec<usize> = std::iter::from_fn(|| ready.pop()).map(StageIndex::index).collect();
        assert_eq!(order, [1, 2, 3, 0]);
    }

    #[test]
    fn a_stage_that_waits_is_tried_ever_more_rarely() {
        let (mut elsewhere, stage, start) = (Elsewhere::default(), StageIndex::new(0), Instant::now());
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
