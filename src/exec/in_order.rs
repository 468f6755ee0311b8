//! Puts events into the order that reporters rely on: a stage starts after the stages that feed it have finished.
//!
//! In fact a stage starts as soon as its inputs can be read, which is before they are durable and count as finished. Reported
//! as it happens, a stage would seem to start before its input exists.

use std::collections::{BTreeMap, BTreeSet};

use super::event::Event;
use crate::plan;
use crate::resolve::{Graph, StageIndex};

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
    pub fn next(&mut self, graph: &Graph, event: &Event) -> Vec<Event> {
        let mut emitted = Vec::new();
        self.take(graph, event.clone(), &mut emitted);
        emitted
    }

    fn take(&mut self, graph: &Graph, event: Event, emitted: &mut Vec<Event>) {
        let mut open = vec![event];
        while let Some(event) = open.pop() {
            let Some(stage) = stage_of(&event) else {
                emitted.push(event);
                continue;
            };
            if let Some(held) = self.held.get_mut(&stage) {
                held.push(event);
                continue;
            }
            if let Event::StageStarted { .. } = event {
                let waits = plan::feeding(graph, stage).any(|feeder| self.open.contains(&feeder));
                self.open.insert(stage);
                if waits {
                    self.held.insert(stage, vec![event]);
                    continue;
                }
            }
            let is_end = matches!(
                event,
                Event::StageFinished { .. }
                    | Event::StageFailed { .. }
                    | Event::Stopped { .. }
                    | Event::Skipped { .. }
            );
            emitted.push(event);
            if is_end && self.open.remove(&stage) {
                // The loop takes the last one first.
                open.extend(self.released(graph).into_iter().rev());
            }
        }
    }

    /// The events of stages that no longer wait for anything.
    fn released(&mut self, graph: &Graph) -> Vec<Event> {
        let is_free =
            |stage: &StageIndex| !plan::feeding(graph, *stage).any(|feeder| self.open.contains(&feeder));
        let free: Vec<StageIndex> = self.held.keys().copied().filter(is_free).collect();
        for stage in &free {
            self.open.remove(stage);
        }
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
        | Event::Skipped { stage, .. } => Some(*stage),
        _ => None,
    }
}
