//! Lines for a file or a pipe: one per finished stage, and progress lines for long stages.

use std::collections::BTreeMap;
use std::time::{Duration, Instant};

use dril_stage_api::Progress;

use super::text::{EventText, Line};
use super::{Ending, Reporter};
use crate::cli::terminal::{Terminal, duration, printable};
use crate::exec::Event;
use crate::plan::Plan;
use crate::resolve::{Graph, StageIndex};

/// A stage that runs this long gets a progress line; the next one follows after twice the time, and so on.
const FIRST_LINE: Duration = Duration::from_secs(30);
/// The longest time between two progress lines.
const LONGEST_SILENCE: Duration = Duration::from_secs(300);

/// When a stage started, and when its next line is due.
struct Pace {
    began: Instant,
    due: Duration,
}

/// Prints plain lines.
pub(super) struct Plain<'g> {
    text: EventText<'g>,
    running: BTreeMap<StageIndex, Pace>,
}

impl<'g> Plain<'g> {
    pub fn new(graph: &'g Graph, terminal: Terminal) -> Self {
        Self { text: EventText::new(graph, terminal), running: BTreeMap::new() }
    }

    fn progressed(&mut self, stage: StageIndex, progress: &Progress) {
        let Some(pace) = self.running.get_mut(&stage) else { return };
        let ran = pace.began.elapsed();
        if ran >= pace.due {
            pace.due = next_line(ran);
            let text = format!("  {} after {}: {}", self.text.id(stage), duration(ran), reading(progress));
            Line::Out(text).print();
        }
    }
}

/// When the line after one at `ran` is due.
fn next_line(ran: Duration) -> Duration {
    (ran * 2).min(ran + LONGEST_SILENCE)
}

/// `512/2000 steps, score 812`.
fn reading(progress: &Progress) -> String {
    let Progress { step, total, unit, note } = progress;
    let steps = if *total > 0 { format!("{step}/{total} {unit}") } else { format!("{step} {unit}") };
    let text = if note.is_empty() { steps } else { format!("{steps}, {note}") };
    printable(&text).replace('\n', " ")
}

impl Reporter for Plain<'_> {
    fn planned(&mut self, plan: &Plan<'_>, threads: usize) {
        Line::Out(self.text.planned(plan, threads)).print();
    }

    fn event(&mut self, event: &Event) {
        match event {
            Event::StageStarted { stage, .. } => {
                self.running.insert(*stage, Pace { began: Instant::now(), due: FIRST_LINE });
            }
            Event::Progressed { stage, progress } => self.progressed(*stage, progress),
            Event::StageFinished { stage, .. }
            | Event::StageFailed { stage, .. }
            | Event::Waiting { stage }
            | Event::Cached { stage, .. }
            | Event::Stopped { stage } => {
                self.running.remove(stage);
            }
            _ => {}
        }
        if let Some(line) = self.text.event(event) {
            line.print();
        }
    }

    fn ended(&mut self, ending: &Ending<'_>) {
        self.text.ended(ending).into_iter().for_each(Line::print);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn progress_lines_come_at_growing_intervals_of_at_most_five_minutes() {
        let mut due = vec![FIRST_LINE];
        while due.len() < 8 {
            due.extend(due.last().copied().map(next_line));
        }
        let seconds: Vec<u64> = due.iter().map(Duration::as_secs).collect();
        assert_eq!(seconds, [30, 60, 120, 240, 480, 780, 1080, 1380]);
    }
}
