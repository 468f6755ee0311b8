//! The ways to tell how a run goes: moving bars on a terminal, plain lines elsewhere, lines of JSON, or errors alone.
//! They listen to events and own nothing of the run.

mod bars;
mod json;
mod plain;
mod quiet;
mod story;

pub(super) use json::error_line;

use std::time::Duration;

use super::args::RunArgs;
use super::results::Published;
use super::terminal::Terminal;
use crate::error::Error;
use crate::exec::{Event, Executed};
use crate::plan::Plan;
use crate::resolve::{Graph, StageIndex};

/// Somebody who tells how a run goes.
pub(super) trait Reporter {
    /// The plan is made; nothing runs yet.
    fn planned(&mut self, plan: &Plan<'_>, threads: usize);
    /// Something happened.
    fn event(&mut self, event: &Event);
    /// The run is over and its results are copied.
    fn ended(&mut self, ending: &Ending<'_>);
}

/// What came of a run.
#[derive(Clone, Copy, Debug)]
pub(super) struct Ending<'a> {
    /// What was executed.
    pub executed: &'a Executed,
    /// The results folder; `None` where there are no results.
    pub published: Option<&'a Published>,
    /// Why results could not be copied.
    pub error: Option<&'a Error>,
    /// What is left for the next run, where this one ran out of time.
    pub left: Option<&'a Left>,
    /// The program's exit code.
    pub exit_code: u8,
}

/// What a run whose time is over leaves to the next one.
#[derive(Clone, Debug)]
pub(super) struct Left {
    /// The stages that are not done.
    pub stages: Vec<StageIndex>,
    /// How long they will take, by earlier runs: at most, where some of them have a checkpoint.
    pub time: Duration,
    /// How many of them nothing is known of.
    pub unknown: usize,
    /// With so many threads.
    pub threads: usize,
}

/// The reporter that the arguments and the terminal ask for.
pub(super) fn choose<'g>(args: &RunArgs, graph: &'g Graph) -> Box<dyn Reporter + 'g> {
    let terminal = Terminal::stdout();
    if args.json {
        Box::new(json::Json::new(graph))
    } else if args.quiet {
        Box::new(quiet::Quiet::new(graph))
    } else if terminal.live {
        Box::new(bars::Bars::new(graph, terminal))
    } else {
        Box::new(plain::Plain::new(graph, terminal))
    }
}
