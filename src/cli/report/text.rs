//! Events as text: the lines that both plain output and progress bars print.

use std::collections::HashMap;
use std::path::Path;

use super::Ending;
use crate::cli::commands::inspect::size;
use crate::cli::names::Names;
use crate::cli::terminal::{
    Style, Terminal, count, cut, duration, estimate, print, print_error, printable, shown,
};
use crate::exec::{Event, RunOutcome};
use crate::plan::{Counts, Plan, Verdict};
use crate::resolve::{Graph, StageIndex};
use crate::session::{Remaining, Rewritten, cut_names};
use crate::store::Key;

/// The number of groups of skipped stages that are listed.
const MAX_GROUPS: usize = 8;

/// The number of notes about shortened file names that are listed.
const MAX_NOTES: usize = 5;

/// The number of files that stay and of failed stages that are listed.
const MAX_NAMES: usize = 12;

/// Longer errors are cut; the log is complete.
const MAX_ERROR: usize = 4000;

/// One or more lines, and the stream that they go to.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(super) enum Line {
    /// To stdout.
    Out(String),
    /// To stderr.
    Error(String),
}

impl Line {
    /// Prints it.
    pub fn print(self) {
        match self {
            // A closed pipe must not stop a run of a week.
            Self::Out(text) => drop(print(&(text + "\n"))),
            Self::Error(text) => print_error(&(text + "\n")),
        }
    }
}

/// Turns events into lines.
pub(super) struct EventText<'g> {
    graph: &'g Graph,
    terminal: Terminal,
    total: usize,
    done: usize,
    /// Cache hits of the plan, by node index; these get no line.
    known: Vec<bool>,
    /// Started stages by key: other stages may have the same key.
    started: HashMap<Key, StageIndex>,
    failed: Vec<StageIndex>,
    /// The first instance of a stage that failed with this error and these last lines of its log.
    first_failed: HashMap<(&'g str, String, Vec<String>), StageIndex>,
    skipped: Vec<StageIndex>,
}

impl<'g> EventText<'g> {
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
            first_failed: HashMap::new(),
            skipped: Vec::new(),
        }
    }

    /// The name of an instance.
    pub fn id(&self, stage: StageIndex) -> &'g str {
        self.graph.stages.node_weight(stage).map_or("", |stage| &stage.id)
    }

    /// Finished stages, and all stages.
    pub fn progress(&self) -> (usize, usize) {
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
            text += &format!(", {run} to run, {depends} downstream; {}", count(threads, "thread"));
            for note in cut_names(self.graph).iter().take(MAX_NOTES) {
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
                let twin = self
                    .started
                    .get(key)
                    .filter(|twin| *twin != stage)
                    .and_then(|twin| self.graph.stages.node_weight(*twin));
                let more = twin.map(|twin| format!(": same key as {}", twin.id)).unwrap_or_default();
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
                Some(self.line(Style::Notable, "retry", *stage, &more))
            }
            Event::StageFailed { stage, failure: reason, log_tail, log } => {
                self.done += 1;
                self.failed.push(*stage);
                Some(Line::Error(self.failure(*stage, reason.to_string(), log_tail, log)))
            }
            Event::Skipped { stage, .. } => {
                // There can be many; the summary lists them in groups.
                self.done += 1;
                self.skipped.push(*stage);
                None
            }
            Event::Stopped { stage } => Some(self.line(Style::Notable, "stopped", *stage, "")),
            Event::Waiting { stage } => {
                Some(self.line(Style::Quiet, "waiting", *stage, " (another process is building it)"))
            }
            Event::Stopping { out_of_time } => {
                let text = if *out_of_time {
                    "time is up: running stages write a checkpoint and stop"
                } else {
                    "stopping: running stages write a checkpoint; press Ctrl-C again to quit immediately"
                };
                Some(Line::Out(self.terminal.paint(Style::Notable, text)))
            }
            Event::Started { .. } | Event::Progressed { .. } | Event::Finished { .. } => None,
        }
    }

    /// A failure in full, or that it is the one of another instance.
    fn failure(&mut self, stage: StageIndex, error: String, log_tail: &[String], log: &Path) -> String {
        let name = self.graph.stages.node_weight(stage).map_or("", |stage| &stage.name);
        let first = *self.first_failed.entry((name, error.clone(), log_tail.to_vec())).or_insert(stage);
        if first == stage {
            return failure(self.id(stage), &error, log_tail, log);
        }
        let (id, first) = (self.id(stage), self.id(first));
        format!("error: stage `{id}` failed like `{first}`\n  log: {}", shown(log))
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
        if let Some(exchange) = ending.exchange.filter(|it| it.taken.results() + it.given.new > 0) {
            let (taken, given) = (&exchange.taken, &exchange.given);
            text += &format!(
                "\nshared cache: took {} ({}), gave {} ({})",
                count(taken.results(), "result"),
                size(taken.bytes()),
                given.new,
                size(given.bytes)
            );
        }
        if let Some(published) = &ending.finished.published {
            let folder = shown(&published.folder);
            text += &format!("\nresults: {folder} ({})", count(published.files, "file"));
            if !published.earlier.is_empty() {
                let names = listed(&published.earlier);
                text += &format!(
                    "\n  from an earlier run, because their stages were not selected or did not finish: {names}"
                );
            }
            if !published.removed.is_empty() {
                text += &format!(
                    "\n  removed, because no stage makes them any more: {}",
                    published.removed.join(", ")
                );
            }
        }
        if let Some(Rewritten { path, lines }) = &ending.finished.locked {
            text += &format!("\nlock file: {} ({} changed)", shown(path), count(*lines, "line"));
        }
        text
    }

    /// What is left for the next run.
    fn left(&self, left: &Remaining) -> String {
        let stages = Names::new(self.graph).groups(&left.stages, MAX_GROUPS);
        let mut text = format!("\n  left: {stages}");
        if left.time.as_secs() > 0 {
            text += &format!("; about {} on {}", estimate(left.time), count(left.threads, "thread"));
        }
        if left.unknown > 0 {
            text += &format!("; no estimate for {}, which never ran before", count(left.unknown, "stage"));
        }
        text
    }

    fn verdict(&self, outcome: &RunOutcome) -> String {
        let RunOutcome { cached, ran, failed, skipped, stopped, took, out_of_time } = outcome;
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
            format!("{word}: {counts}, in {took}; the next run resumes")
        } else {
            format!("{}: {counts}, in {took}", self.terminal.paint(Style::Bad, "failed"))
        };
        if self.failed.len() > MAX_NAMES {
            let mut failed = self.failed.clone();
            failed.sort_unstable();
            text += &format!("\n  failed: {}", Names::new(self.graph).groups(&failed, MAX_GROUPS));
        } else {
            let failed = self.failed.iter().map(|stage| format!("\n  failed: {}", self.id(*stage)));
            text += &failed.collect::<String>();
        }
        if !self.skipped.is_empty() {
            let mut skipped = self.skipped.clone();
            skipped.sort_unstable();
            text += &format!("\n  skipped: {}", Names::new(self.graph).groups(&skipped, MAX_GROUPS));
        }
        text
    }
}

/// The first names, and the number of the others.
fn listed(names: &[String]) -> String {
    let shown = names.iter().take(MAX_NAMES).map(String::as_str).collect::<Vec<_>>().join(", ");
    match names.len().saturating_sub(MAX_NAMES) {
        0 => shown,
        more => format!("{shown} and {more} more"),
    }
}

/// A failed stage: the error, the end of its log, and the path of the log.
pub(super) fn failure(id: &str, error: &str, log_tail: &[String], log: &Path) -> String {
    let error = cut(&printable(error.trim_end()), MAX_ERROR);
    let mut text = format!("error: stage `{id}` failed: {}", error.replace('\n', "\n  "));
    if !log_tail.is_empty() {
        text += "\n  last lines of its log:";
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

    fn verdict(outcome: RunOutcome) -> String {
        let graph = Graph {
            pipeline: "p".into(),
            profile: "q".into(),
            left_out: Vec::new(),
            sweeps: Vec::new(),
            stages: DiGraph::default(),
        };
        EventText::new(&graph, Terminal::PLAIN).verdict(&outcome)
    }

    #[test]
    fn a_run_without_work_says_that_nothing_was_executed() {
        let outcome = RunOutcome { cached: 110, took: Duration::from_millis(40), ..RunOutcome::default() };
        assert_eq!(verdict(outcome), "nothing to do: 0 stages executed, all 110 cached, in 0.04 s");
    }

    #[test]
    fn the_summary_has_every_count_that_is_not_zero() {
        let took = Duration::from_secs(75);
        let done = RunOutcome { cached: 2, ran: 3, took, ..RunOutcome::default() };
        assert_eq!(verdict(done), "done: 3 ran, 2 cached, in 1 min 15 s");
        let failed = RunOutcome { ran: 3, failed: 1, skipped: 2, took, ..RunOutcome::default() };
        assert_eq!(verdict(failed), "failed: 3 ran, 1 failed, 2 skipped, in 1 min 15 s");
        let stopped = RunOutcome { ran: 3, stopped: 4, took, ..RunOutcome::default() };
        let expected = "stopped: 3 ran, 4 not finished, in 1 min 15 s; the next run resumes";
        assert_eq!(verdict(stopped), expected);
    }

    #[test]
    fn a_failure_shows_the_end_of_the_log_and_its_path() {
        let tail = ["epoch 3".to_owned(), "\x1b[31mloss is nan\x1b[0m".to_owned()];
        let expected = "\
error: stage `clone` failed: the loss is not finite
  | see the log
  last lines of its log:
    | epoch 3
    | loss is nan
  log: cache/clone.log";
        let error = "the loss is not finite\n| see the log\n";
        assert_eq!(failure("clone", error, &tail, Path::new("cache/clone.log")), expected);
    }
}
