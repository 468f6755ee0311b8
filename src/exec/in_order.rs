//! Puts events into the order that reporters rely on: a stage starts after the stages that feed it have finished.
//!
//! In fact a stage starts as soon as its inputs can be read, which is before they are durable and count as finished. Reported
//! as it happens, a stage would seem to start before its input exists.

use std::collections::{BTreeMap, BTreeSet};

use super::event::Event;
use crate::resolve::StageIndex;

/// True where a stage that feeds the given one is in the set.
pub(super) type IsFedBy<'g> = &'g dyn Fn(StageIndex, &BTreeSet<StageIndex>) -> bool;

/// Delays events until it is their turn.
#[derive(Debug, Default)]
pub(super) struct InOrder {
    /// Stages that have started and not ended.
    open: BTreeSet<StageIndex>,
    /// The events of stages that started before a stage that feeds them ended.
    held: BTreeMap<StageIndex, Vec<Event>>,
}

impl InOrder {
    /// The events to emit now that `event` has happened.
    pub fn next(&mut self, is_fed_by: IsFedBy<'_>, event: &Event) -> Vec<Event> {
        let mut emitted = Vec::new();
        let mut due = vec![event.clone()];
        while let Some(event) = due.pop() {
            let Some(stage) = stage_of(&event) else {
                emitted.push(event);
                continue;
            };
            if let Some(held) = self.held.get_mut(&stage) {
                held.push(event);
                continue;
            }
            if let Event::StageStarted { .. } = event {
                let waits = is_fed_by(stage, &self.open);
                self.open.insert(stage);
                if waits {
                    self.held.insert(stage, vec![event]);
                    continue;
                }
            }
            // Another machine may take over a stage that has started: then it waits, or turns out to be cached.
            let is_end = matches!(
                event,
                Event::StageFinished { .. }
                    | Event::StageFailed { .. }
                    | Event::Stopped { .. }
                    | Event::Skipped { .. }
                    | Event::Waiting { .. }
                    | Event::Cached { .. }
            );
            emitted.push(event);
            if is_end && self.open.remove(&stage) {
                // The loop takes the last one first.
                due.extend(self.released(is_fed_by).into_iter().rev());
            }
        }
        emitted
    }

    /// The events of stages that no longer wait for anything. The stages stay open until their end is emitted, so that a
    /// stage that they feed still waits for them.
    fn released(&mut self, is_fed_by: IsFedBy<'_>) -> Vec<Event> {
        let is_free = |stage: &StageIndex| !is_fed_by(*stage, &self.open);
        let free: Vec<StageIndex> = self.held.keys().copied().filter(is_free).collect();
        free.iter().flat_map(|stage| self.held.remove(stage).unwrap_or_default()).collect()
    }

    /// The events that are still delayed, for the end of a run that was cut off.
    pub fn rest(&mut self) -> Vec<Event> {
        std::mem::take(&mut self.held).into_values().flatten().collect()
    }
}

fn stage_of(event: &Event) -> Option<StageIndex> {
    match event {
        Event::StageStarted { stage, .. }
        | Event::Progressed { stage, .. }
        | Event::StageFinished { stage, .. }
        | Event::StageFailed { stage, .. }
        | Event::Retrying { stage, .. }
        | Event::Stopped { stage }
        | Event::Waiting { stage }
        | Event::Cached { stage, .. }
        | Event::Skipped { stage, .. } => Some(*stage),
        _ => None,
    }
}

#[cfg(test)]
mod tests {
    use std::time::Duration;

    use proptest::prelude::*;

    use super::*;
    use crate::store::Key;

    fn start(stage: usize) -> Event {
        let key = Key::new([0; 32]);
        Event::StageStarted { stage: StageIndex::new(stage), key, why: Vec::new() }
    }

    fn end(stage: usize) -> Event {
        Event::StageFinished { stage: StageIndex::new(stage), took: Duration::ZERO }
    }

    /// What is emitted for a run's events, as `+2` for a start and `-2` for an end.
    fn emitted(feeders: &[Vec<usize>], events: impl IntoIterator<Item = Event>) -> Vec<String> {
        let is_fed_by = |stage: StageIndex, open: &BTreeSet<StageIndex>| {
            feeders[stage.index()].iter().any(|feeder| open.contains(&StageIndex::new(*feeder)))
        };
        let mut order = InOrder::default();
        let events: Vec<Event> =
            events.into_iter().flat_map(|event| order.next(&is_fed_by, &event)).collect();
        let line = |event: Event| match event {
            Event::StageStarted { stage, .. } => format!("+{}", stage.index()),
            Event::StageFinished { stage, .. } => format!("-{}", stage.index()),
            other => format!("{other:?}"),
        };
        events.into_iter().chain(order.rest()).map(line).collect()
    }

    #[test]
    fn a_stage_waits_for_all_its_feeders_also_where_they_are_released_together() {
        // 0 feeds 1 and 2, which feed 3; 0 is durable last but for 2.
        let feeders = [vec![], vec![0], vec![0], vec![1, 2]];
        let events = [start(0), start(1), start(2), start(3), end(1), end(0), end(2), end(3)];
        assert_eq!(emitted(&feeders, events), ["+0", "-0", "+1", "-1", "+2", "-2", "+3", "-3"]);
    }

    proptest! {
        #[test]
        fn whatever_becomes_durable_first_a_stage_starts_after_its_feeders_ended(
            drawn in proptest::collection::vec(proptest::collection::vec(any::<prop::sample::Index>(), 0..3), 1..9),
            ends in proptest::collection::vec(any::<u8>(), 9),
        ) {
            let feeders: Vec<Vec<usize>> = (0..drawn.len())
                .map(|at| drawn[at].iter().filter(|_| at > 0).map(|index| index.index(at)).collect())
                .collect();
            // Stages start in order; each ends at some time after its start.
            let mut ending: Vec<(usize, u8, usize)> =
                (0..feeders.len()).map(|at| (at + usize::from(ends[at] % 5), ends[at], at)).collect();
            ending.sort_unstable();
            let mut events = Vec::new();
            for at in 0..feeders.len() + 5 {
                if at < feeders.len() {
                    events.push(start(at));
                }
                events.extend(ending.iter().filter(|(when, ..)| *when == at).map(|(.., stage)| end(*stage)));
            }
            let emitted = emitted(&feeders, events);
            let position = |sign: char, stage: usize| {
                emitted.iter().position(|event| *event == format!("{sign}{stage}"))
            };
            prop_assert_eq!(emitted.len(), 2 * feeders.len());
            for (stage, feeders) in feeders.iter().enumerate() {
                let started = position('+', stage);
                prop_assert!(started.is_some() && started < position('-', stage));
                for feeder in feeders {
                    prop_assert!(position('-', *feeder) < started, "{:?}", emitted);
                }
            }
        }
    }
}
