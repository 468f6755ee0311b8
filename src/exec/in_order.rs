//! Events in the order that whoever listens may rely on: a stage starts after those that feed it have finished.
//!
//! A stage is started as soon as what it reads can be read, which is before that is durable and its maker counts as
//! finished. Told as it happens, a stage would begin before its input is there.

use std::collections::{BTreeMap, BTreeSet};

use super::Event;
use crate::plan;
use crate::resolve::{Graph, StageIndex};

/// Holds events back until it is their turn.
#[derive(Debug, Default)]
pub(super) struct InOrder {
    /// Stages that have started, and not ended.
    open: BTreeSet<StageIndex>,
    /// The events of stages that started before one that feeds them has ended.
    held: BTreeMap<StageIndex, Vec<Event>>,
}

impl InOrder {
    /// The events that are to be told now that `event` has happened.
    pub fn next(&mut self, graph: &Graph, event: &Event) -> Vec<Event> {
        let mut told = Vec::new();
        self.take(graph, event.clone(), &mut told);
        told
    }

    fn take(&mut self, graph: &Graph, event: Event, told: &mut Vec<Event>) {
        let mut open = vec![event];
        while let Some(event) = open.pop() {
            let Some(stage) = stage_of(&event) else {
                told.push(event);
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
            told.push(event);
            if is_end && self.open.remove(&stage) {
                // The last one is taken first.
                open.extend(self.released(graph).into_iter().rev());
            }
        }
    }

    /// The events of the stages that wait for nothing any more.
    fn released(&mut self, graph: &Graph) -> Vec<Event> {
        let is_free =
            |stage: &StageIndex| !plan::feeding(graph, *stage).any(|feeder| self.open.contains(&feeder));
        let free: Vec<StageIndex> = self.held.keys().copied().filter(is_free).collect();
        for stage in &free {
            self.open.remove(stage);
        }
        free.iter().flat_map(|stage| self.held.remove(stage).unwrap_or_default()).collect()
    }

    /// What is held still, for the end of a run that broke off.
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
