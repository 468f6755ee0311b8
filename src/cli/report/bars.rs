//! Progress bars for a terminal: one per running stage, and one for the whole run below them.

use std::collections::BTreeMap;
use std::fmt::Write as _;
use std::time::{Duration, Instant};

use dril_stage_api::Progress;
use indicatif::{MultiProgress, ProgressBar, ProgressDrawTarget, ProgressState, ProgressStyle};

use super::text::{EventText, Line};
use super::{Ending, Reporter};
use crate::cli::terminal::{Style, Terminal, cut, duration, estimate, printable};
use crate::exec::Event;
use crate::plan::{Plan, Verdict};
use crate::resolve::{Graph, StageIndex};

/// The remaining time of the run is shown once this share of the work is done.
const ENOUGH_TO_ESTIMATE: f64 = 0.02;
/// How often elapsed times are updated.
const TICK: Duration = Duration::from_millis(250);

/// Draws progress bars.
pub(super) struct Bars<'g> {
    text: EventText<'g>,
    graph: &'g Graph,
    terminal: Terminal,
    live: Option<Live>,
    running: BTreeMap<StageIndex, Running>,
    work: Work,
}

/// The bars on the screen. Created when the first stage starts: a run without work draws nothing.
struct Live {
    lines: MultiProgress,
    gap: ProgressBar,
    whole: ProgressBar,
}

/// A running stage's line.
struct Running {
    line: ProgressBar,
    /// Time and step of the first progress message: the stage may have resumed from a checkpoint.
    first: Option<(Instant, u64)>,
    /// The finished share, from 0 to 1.
    share: f64,
}

/// Sums of stage costs, to estimate the remaining time.
#[derive(Debug, Default)]
struct Work {
    began: Option<Instant>,
    /// Waiting or running.
    open: f64,
    /// Done by this run.
    done: f64,
}

impl<'g> Bars<'g> {
    pub fn new(graph: &'g Graph, terminal: Terminal) -> Self {
        let text = EventText::new(graph, terminal);
        Self { text, graph, terminal, live: None, running: BTreeMap::new(), work: Work::default() }
    }

    fn cost(&self, stage: StageIndex) -> f64 {
        self.graph.stages.node_weight(stage).map_or(0.0, |stage| stage.needs.cost.max(0.0))
    }

    /// A short name, `dril[clipped, beta, 20]`: space is limited, and the lines above have the full name.
    fn name(&self, stage: StageIndex) -> String {
        let Some(stage) = self.graph.stages.node_weight(stage) else { return String::new() };
        let values: Vec<&str> = stage.coordinates.iter().map(|(_, value)| &**value).collect();
        if values.is_empty() {
            stage.name.to_string()
        } else {
            format!("{}[{}]", stage.name, values.join(", "))
        }
    }

    fn started(&mut self, stage: StageIndex) {
        self.work.began.get_or_insert_with(Instant::now);
        let live = self.live.get_or_insert_with(Live::new);
        let line = ProgressBar::new_spinner().with_style(style("{spinner} {wide_msg}  {time}"));
        let line = live.lines.insert_before(&live.whole, line);
        line.set_message(self.name(stage));
        line.enable_steady_tick(TICK);
        self.running.insert(stage, Running { line, first: None, share: 0.0 });
    }

    fn progressed(&mut self, stage: StageIndex, progress: &Progress) {
        let name = self.name(stage);
        let Some(running) = self.running.get_mut(&stage) else { return };
        let message = running.message(&name, progress, self.terminal);
        running.line.set_message(message);
    }

    /// The stage has ended, with or without success.
    fn over(&mut self, stage: StageIndex, by_this_run: bool) {
        let cost = self.cost(stage);
        self.work.open -= cost;
        if by_this_run {
            self.work.done += cost;
        }
        self.hide(stage);
    }

    /// Removes the line of a stage.
    fn hide(&mut self, stage: StageIndex) {
        if let (Some(running), Some(live)) = (self.running.remove(&stage), &self.live) {
            running.line.finish_and_clear();
            live.lines.remove(&running.line);
        }
    }

    /// Removes all bars from the screen.
    fn clear(&mut self) {
        for (_, running) in std::mem::take(&mut self.running) {
            running.line.finish_and_clear();
        }
        if let Some(live) = self.live.take() {
            live.whole.finish_and_clear();
            live.gap.finish_and_clear();
        }
    }

    fn draw_whole(&self) {
        let Some(live) = &self.live else { return };
        let (done, total) = self.text.progress();
        let share = done as f64 / total.max(1) as f64;
        let mut text = format!("{done}/{total} stages");
        let under_way = self.running.iter().map(|(stage, running)| self.cost(*stage) * running.share);
        if let Some(left) = self.work.left(under_way.sum()) {
            let _ = write!(text, ", about {} left", estimate(left));
        }
        let room = self.terminal.width.unwrap_or(80).saturating_sub(bar_width(self.terminal) + 16);
        let text = cut(&text, room);
        live.whole.set_message(format!("{} {text}", bar(share, self.terminal)));
    }

    fn say(&self, line: Line) {
        match &self.live {
            Some(live) => live.lines.suspend(|| line.print()),
            None => line.print(),
        }
    }
}

impl Live {
    fn new() -> Self {
        let lines = MultiProgress::with_draw_target(ProgressDrawTarget::stdout());
        // When a terminal echoes `^C`, the cursor is one line lower than expected and the topmost line is not cleared, so the
        // topmost line is empty.
        let gap = lines.add(ProgressBar::new_spinner().with_style(style(" ")));
        gap.tick();
        let whole = lines.add(ProgressBar::new_spinner().with_style(style("  {msg}  {time}")));
        whole.enable_steady_tick(TICK);
        Self { lines, gap, whole }
    }
}

impl Running {
    fn message(&mut self, name: &str, progress: &Progress, terminal: Terminal) -> String {
        let Progress { step, total, unit, note } = progress;
        let (since, from) = *self.first.get_or_insert_with(|| (Instant::now(), *step));
        let mut text = if *total > 0 {
            self.share = (*step as f64 / *total as f64).clamp(0.0, 1.0);
            format!("{} {:>3.0}% {name}", bar(self.share, terminal), (self.share * 100.0).floor())
        } else {
            format!("{name}  {step} {unit}")
        };
        if let Some(left) = time_left(since.elapsed(), from, *step, *total) {
            let _ = write!(text, "  {} left", estimate(left));
        }
        if !note.is_empty() {
            let _ = write!(text, "  {}", terminal.paint(Style::Quiet, &printable(note).replace('\n', " ")));
        }
        text
    }
}

impl Work {
    /// The remaining time at the speed so far; `under_way` is the finished cost of running stages.
    fn left(&self, under_way: f64) -> Option<Duration> {
        let done = self.done + under_way;
        let open = self.open - under_way;
        let elapsed = self.began?.elapsed().as_secs_f64();
        let known = done > ENOUGH_TO_ESTIMATE * (done + open) && elapsed > 3.0 && open > 0.0;
        if known { Duration::try_from_secs_f64(elapsed * open / done).ok() } else { None }
    }
}

/// The remaining time of a stage that came from step `from` to `step` of `total` within `took`.
fn time_left(took: Duration, from: u64, step: u64, total: u64) -> Option<Duration> {
    let made = step.checked_sub(from).filter(|made| *made > 0)? as f64;
    let open = total.checked_sub(step).filter(|open| *open > 0)? as f64;
    if took < Duration::from_secs(1) {
        return None;
    }
    Duration::try_from_secs_f64(took.as_secs_f64() * open / made).ok()
}

fn bar_width(terminal: Terminal) -> usize {
    if terminal.width.is_some_and(|columns| columns < 70) { 8 } else { 16 }
}

/// A bar as wide as the terminal allows.
fn bar(share: f64, terminal: Terminal) -> String {
    let width = bar_width(terminal);
    let filled = (share.clamp(0.0, 1.0) * width as f64).floor() as usize;
    let done = terminal.paint(Style::Good, &"━".repeat(filled));
    done + &terminal.paint(Style::Quiet, &"─".repeat(width - filled))
}

fn style(template: &str) -> ProgressStyle {
    let time = |state: &ProgressState, text: &mut dyn std::fmt::Write| {
        let _ = text.write_str(&duration(state.elapsed()));
    };
    let style = ProgressStyle::with_template(template).unwrap_or_else(|_| ProgressStyle::default_spinner());
    style.with_key("time", time).tick_chars("⠋⠙⠹⠸⠼⠴⠦⠧⠇⠏ ")
}

impl Reporter for Bars<'_> {
    fn planned(&mut self, plan: &Plan<'_>, threads: usize) {
        let stale = plan.steps.iter().filter(|(_, verdict)| !matches!(verdict, Verdict::Cached { .. }));
        self.work.open = stale.map(|(stage, _)| self.cost(*stage)).sum();
        let line = self.text.planned(plan, threads);
        self.say(Line::Out(line));
    }

    fn event(&mut self, event: &Event) {
        let known = self.text.progress().0;
        match event {
            Event::StageStarted { stage, .. } => self.started(*stage),
            Event::Progressed { stage, progress } => self.progressed(*stage, progress),
            Event::StageFinished { stage, .. } => self.over(*stage, true),
            Event::StageFailed { stage, .. } | Event::Skipped { stage, .. } | Event::Stopped { stage } => {
                self.over(*stage, false);
            }
            // Another machine has taken it over.
            Event::Waiting { stage } => self.hide(*stage),
            _ => {}
        }
        let line = self.text.event(event);
        // A stage that was stale in the plan and turned out to be cached is work that is not needed.
        if let (Event::Cached { stage, .. }, Some(_)) = (event, &line) {
            self.over(*stage, false);
        }
        if let Some(line) = line {
            self.say(line);
        }
        if self.live.is_some() && (known != self.text.progress().0 || !self.running.is_empty()) {
            self.draw_whole();
        }
    }

    fn ended(&mut self, ending: &Ending<'_>) {
        self.clear();
        self.text.ended(ending).into_iter().for_each(Line::print);
    }
}

impl Drop for Bars<'_> {
    /// If an error ends the run, reporters are not called again, but the error needs a clean screen.
    fn drop(&mut self) {
        self.clear();
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_resumed_stage_is_not_mistaken_for_a_fast_one() {
        let took = Duration::from_secs(10);
        assert_eq!(time_left(took, 0, 50, 100), Some(took));
        assert_eq!(time_left(took, 40, 50, 100), Some(took * 5));
        assert_eq!(time_left(took, 50, 50, 100), None);
        assert_eq!(time_left(took, 0, 100, 100), None);
        assert_eq!(time_left(took, 0, 5, 0), None);
    }

    #[test]
    fn a_bar_has_one_width_at_every_share() {
        for share in [-1.0, 0.0, 0.3, 0.999, 1.0, 7.0] {
            assert_eq!(bar(share, Terminal::PLAIN).chars().count(), 16, "{share}");
        }
    }
}
