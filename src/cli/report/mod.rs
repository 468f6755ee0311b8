//! Reporters show the progress of a run: progress bars on a terminal, plain lines elsewhere, JSON lines, or only errors. They
//! listen to events and own no state of the run.

mod bars;
mod json;
mod plain;
mod quiet;
mod text;

pub(super) use json::{error_line, seconds_since};

use std::time::Instant;

use super::args::RunArgs;
use super::shared::Exchange;
use super::terminal::Terminal;
use crate::exec::Event;
use crate::plan::Plan;
use crate::resolve::Graph;
use crate::session::Finished;

/// Shows the progress of a run.
pub(super) trait Reporter {
    /// The plan is ready; nothing runs yet.
    fn planned(&mut self, plan: &Plan<'_>, threads: usize);
    /// An event.
    fn event(&mut self, event: &Event);
    /// The run has ended and its results are copied.
    fn ended(&mut self, ending: &Ending<'_>);
}

/// The end of a run.
#[derive(Clone, Copy, Debug)]
pub(super) struct Ending<'a> {
    /// The run.
    pub finished: &'a Finished,
    /// What came from the shared cache and went to it; `None` where there is none.
    pub exchange: Option<&'a Exchange>,
    /// The program's exit code.
    pub exit_code: u8,
}

/// The reporter that the arguments and the terminal ask for; `began` is the start of the run.
pub(super) fn choose<'g>(args: &RunArgs, graph: &'g Graph, began: Instant) -> Box<dyn Reporter + 'g> {
    let terminal = Terminal::stdout();
    if args.json {
        Box::new(json::Json::new(graph, began))
    } else if args.quiet {
        Box::new(quiet::Quiet::new(graph))
    } else if terminal.live {
        Box::new(bars::Bars::new(graph, terminal))
    } else {
        Box::new(plain::Plain::new(graph, terminal))
    }
}
