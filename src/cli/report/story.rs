//! A run told in lines for people: what both the plain and the moving output print.

use std::collections::HashMap;
use std::path::Path;

use super::Ending;
use crate::cli::names::Names;
use crate::cli::terminal::{
    Style, Terminal, count, cut, duration, estimate, print, print_error, printable, shown,
};
use crate::exec::{Event, Outcome};
use crate::plan::{Counts, Plan, Verdict};
use crate::resolve::{Graph, StageIndex};
use crate::session::{Remaining, cut_names};
use crate::store::Key;

/// At most so many stages are named as skipped.
const MOST_SKIPPED: usize = 8;

/// At most so many results are named that get a shorter name.
const MOST_NOTES: usize = 5;

/// Longer errors are cut; the log has what a program printed.
const LONGEST_ERROR: usize = 4000;

/// A line (or a block of lines) and where it goes.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(super) enum Line {
    /// To standard output.
    Out(String),
    /// To standard error.
    Error(String),
}

impl Line {
    /// Prints it.
    pub fn print(self) {
        match self {
            // A reader that has gone is no reason to stop a run of a week.
            Self::Out(text) => drop(print(&(text + "\n"))),
            Self::Error(text) => print_error(&(text + "\n")),
        }
    }
}

/// Turns events into lines.
pub(super) struct Story<'g> {
    graph: &'g Graph,
    terminal: Terminal,
    total: usize,
    done: usize,
    /// Cached from the start, by node index: not worth a line.
    known: Vec<bool>,
    /// What was started, by its key: other stages may be the same work.
    started: HashMap<Key, StageIndex>,
    failed: Vec<StageIndex>,
    skipped: Vec<StageIndex>,
}

impl<'g> Story<'g> {
    pub fn new(graph: &'g Graph, terminal: Terminal) -> Self {
        let total = graph.stages.node_count();
        Self {
            graph,
            terminal,
            total,
            done: 0,
            known: vec![false; total],
            started: HashMap::new(),
            failed: Vec::new(),
            skipped: Vec::new(),
        }
    }

    /// The name of an instance.
    pub fn id(&self, stage: StageIndex) -> &'g str {
        self.graph.stages.node_weight(stage).map_or("", |stage| &stage.id)
    }

    /// Stages that are settled, of all.
    pub fn settled(&self) -> (usize, usize) {
        (self.done, self.total)
    }

    /// The first line.
    pub fn planned(&mut self, plan: &Plan<'_>, threads: usize) -> String {
        for (stage, verdict) in &plan.steps {
            if let (Verdict::Cached { .. }, Some(known)) = (verdict, self.known.get_mut(stage.index())) {
                *known = true;
            }
        }
        let Counts { cached, run, depends } = plan.counts();
        let title = format!("{}, profile {}", self.graph.pipeline, self.graph.profile);
        let mut text = self.terminal.paint(Style::Strong, &title);
        text += &format!(": {}, {cached} cached", count(self.total, "stage"));
        if run + depends > 0 {
            text += &format!(", {run} to run, {depends} behind; {}", count(threads, "thread"));
            for note in cut_names(self.graph).iter().take(MOST_NOTES) {
                text += &format!("\n  note: {note}");
            }
        }
        text
    }

    /// The line of an event, if it has one.
    pub fn event(&mut self, event: &Event) -> Option<Line> {
        match event {
            Event::StageStarted { stage, key, .. } => {
                self.started.insert(*key, *stage);
                None
            }
            Event::Cached { stage, key } => {
                self.done += 1;
                let known = self.known.get(stage.index()).copied().unwrap_or_default();
                let twin = self.started.get(key).and_then(|twin| self.graph.stages.node_weight(*twin));
                let more = twin.map(|twin| format!(": the same work as {}", twin.id)).unwrap_or_default();
                (!known).then(|| self.line(Style::Quiet, "cached", *stage, &more))
            }
            Event::StageFinished { stage, took } => {
                self.done += 1;
                Some(self.line(Style::Good, "ran", *stage, &format!(" in {}", duration(*took))))
            }
            Event::Retrying { stage, retry, of, failure, pause } => {
                let error = failure.to_string();
                let first = printable(error.lines().next().unwrap_or_default());
                let more = format!(" in {} ({retry} of {of}): {first}", duration(*pause));
                Some(self.line(Style::Notable, "again", *stage, &more))
            }
            Event::StageFailed { stage, failure: reason, log_tail, log } => {
                self.done += 1;
                self.failed.push(*stage);
                Some(Line::Error(failure(self.id(*stage), &reason.to_string(), log_tail, log)))
            }
            Event::Skipped { stage, .. } => {
                // They can be many; the end names them in groups.
                self.done += 1;
                self.skipped.push(*stage);
                None
            }
            Event::Stopped { stage } => Some(self.line(Style::Notable, "stopped", *stage, "")),
            Event::Waiting { stage } => {
                Some(self.line(Style::Quiet, "waiting", *stage, " (it is being made already)"))
            }
            Event::Stopping { out_of_time } => {
                let text = if *out_of_time {
                    "the time is over: running stages save their state"
                } else {
                    "stopping: running stages save their state; once more to end at once"
                };
                Some(Line::Out(self.terminal.paint(Style::Notable, text)))
            }
            Event::Started { .. } | Event::Progressed { .. } | Event::Finished { .. } => None,
        }
    }

    fn line(&self, style: Style, word: &str, stage: StageIndex, more: &str) -> Line {
        let width = self.total.to_string().len();
        let word = self.terminal.paint(style, &format!("{word:<7}"));
        let count = format!("[{:>width$}/{}]", self.done, self.total);
        Line::Out(format!("{count} {word} {}{more}", self.id(stage)))
    }

    /// The last lines.
    pub fn ended(&self, ending: &Ending<'_>) -> Vec<Line> {
        let error =
            ending.finished.error.as_ref().map(|error| Line::Error(error.to_string().trim_end().to_owned()));
        [Line::Out(self.end(ending))].into_iter().chain(error).collect()
    }

    fn end(&self, ending: &Ending<'_>) -> String {
        let mut text = self.verdict(&ending.finished.executed.outcome);
        if let Some(left) = &ending.finished.remaining {
            text += &self.left(left);
        }
        if let Some(published) = &ending.finished.published {
            let folder = shown(&published.folder);
            text += &format!("\nresults: {folder} ({})", count(published.files, "file"));
            if !published.earlier.is_empty() {
                let names = published.earlier.join(", ");
                text += &format!(
                    "\n  of an earlier run, as their stages were not asked for or did not finish: {names}"
                );
            }
            if !published.removed.is_empty() {
                text +=
                    &format!("\n  removed, as nothing makes them any more: {}", published.removed.join(", "));
            }
        }
        text
    }

    /// What the next run has to do.
    fn left(&self, left: &Remaining) -> String {
        let stages = Names::new(self.graph).groups(&left.stages, MOST_SKIPPED);
        let mut text = format!("\n  left: {stages}");
        if left.time.as_secs() > 0 {
            text += &format!("; about {} on {}", estimate(left.time), count(left.threads, "thread"));
        }
        if left.unknown > 0 {
            text += &format!("; {} never ran before, so nobody knows how long", count(left.unknown, "stage"));
        }
        text
    }

    fn verdict(&self, outcome: &Outcome) -> String {
        let Outcome { cached, ran, failed, skipped, stopped, took, out_of_time } = outcome;
        let took = duration(*took);
        if outcome.is_complete() && *ran == 0 {
            let text = self.terminal.paint(Style::Good, "nothing to do");
            return format!("{text}: 0 stages executed, all {cached} cached, in {took}");
        }
        let counts = [(ran, "ran"), (cached, "cached"), (failed, "failed"), (skipped, "skipped")];
        let counts = counts.into_iter().chain([(stopped, "not finished")]);
        let counts: Vec<String> = counts
            .filter(|(number, _)| **number > 0)
            .map(|(number, word)| format!("{number} {word}"))
            .collect();
        let counts = counts.join(", ");
        if outcome.is_complete() {
            return format!("{}: {counts}, in {took}", self.terminal.paint(Style::Good, "done"));
        }
        let mut text = if *stopped > 0 {
            let word = if *out_of_time { "out of time" } else { "stopped" };
            let word = self.terminal.paint(Style::Notable, word);
            format!("{word}: {counts}, in {took}; the next run goes on from here")
        } else {
            format!("{}: {counts}, in {took}", self.terminal.paint(Style::Bad, "failed"))
        };
        for stage in &self.failed {
            text += &format!("\n  failed: {}", self.id(*stage));
        }
        if !self.skipped.is_empty() {
            let mut skipped = self.skipped.clone();
            skipped.sort_unstable();
            text += &format!("\n  skipped: {}", Names::new(self.graph).groups(&skipped, MOST_SKIPPED));
        }
        text
    }
}

/// A failed stage: the error, the end of its log, and where the whole log is.
pub(super) fn failure(id: &str, error: &str, log_tail: &[String], log: &Path) -> String {
    let error = cut(&printable(error.trim_end()), LONGEST_ERROR);
    let mut text = format!("error: stage `{id}` failed: {}", error.replace('\n', "\n  "));
    if !log_tail.is_empty() {
        text += "\n  the end of its log:";
        for line in log_tail {
            text += &format!("\n    | {}", printable(line).replace('\n', " "));
        }
    }
    text + &format!("\n  log: {}", shown(log))
}

#[cfg(test)]
mod tests {
    use super::*;
    use petgraph::graph::DiGraph;
    use std::time::Duration;

    fn told(outcome: Outcome) -> String {
        let graph = Graph { pipeline: "p".into(), profile: "q".into(), stages: DiGraph::default() };
        Story::new(&graph, Terminal::PLAIN).verdict(&outcome)
    }

    #[test]
    fn a_run_without_work_says_that_nothing_was_executed() {
        let outcome = Outcome { cached: 110, took: Duration::from_millis(40), ..Outcome::default() };
        assert_eq!(told(outcome), "nothing to do: 0 stages executed, all 110 cached, in 0.04 s");
    }

    #[test]
    fn the_end_names_every_count_that_is_not_zero() {
        let took = Duration::from_secs(75);
        let done = Outcome { cached: 2, ran: 3, took, ..Outcome::default() };
        assert_eq!(told(done), "done: 3 ran, 2 cached, in 1 min 15 s");
        let failed = Outcome { ran: 3, failed: 1, skipped: 2, took, ..Outcome::default() };
        assert_eq!(told(failed), "failed: 3 ran, 1 failed, 2 skipped, in 1 min 15 s");
        let stopped = Outcome { ran: 3, stopped: 4, took, ..Outcome::default() };
        let expected = "stopped: 3 ran, 4 not finished, in 1 min 15 s; the next run goes on from here";
        assert_eq!(told(stopped), expected);
    }

    #[test]
    fn a_failure_shows_the_end_of_the_log_and_where_it_is() {
        let tail = ["epoch 3".to_owned(), "\x1b[31mloss is nan\x1b[0m".to_owned()];
        let expected = "\
error: stage `clone` failed: the loss is not finite
  | see the log
  the end of its log:
    | epoch 3
    | loss is nan
  log: cache/clone.log";
        let error = "the loss is not finite\n| see the log\n";
        assert_eq!(failure("clone", error, &tail, Path::new("cache/clone.log")), expected);
    }
}
