//! Only errors.

use super::text::failure;
use super::{Ending, Reporter};
use crate::cli::terminal::print_error;
use crate::exec::Event;
use crate::plan::Plan;
use crate::resolve::Graph;

/// Prints failed stages to stderr, and nothing else.
pub(super) struct Quiet<'g> {
    graph: &'g Graph,
}

impl<'g> Quiet<'g> {
    pub fn new(graph: &'g Graph) -> Self {
        Self { graph }
    }
}

impl Reporter for Quiet<'_> {
    fn planned(&mut self, _: &Plan<'_>, _: usize) {}

    fn event(&mut self, event: &Event) {
        if let Event::StageFailed { stage, failure: reason, log_tail, log } = event {
            let id = self.graph.stages.node_weight(*stage).map_or("", |stage| &stage.id);
            print_error(&(failure(id, &reason.to_string(), log_tail, log) + "\n"));
        }
    }

    fn ended(&mut self, ending: &Ending<'_>) {
        if let Some(error) = &ending.finished.error {
            print_error(&error.to_string());
        }
    }
}
