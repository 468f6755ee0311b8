//! `dril-pipe explain` without a stage: one line per cause, with the number of stages downstream.

use std::collections::HashMap;
use std::sync::Arc;

use crate::cli::change::{Change, Changed, grouped};
use crate::cli::columns;
use crate::cli::names::Names;
use crate::cli::terminal::{Style, Terminal, count};
use crate::plan::{Plan, Reason, Verdict};
use crate::resolve::StageIndex;

/// The number of lines; `--json` has all.
const MOST_LINES: usize = 200;

/// One cause: instances of a stage that differ in the same way.
struct Line<'g> {
    stage: &'g str,
    instances: Vec<StageIndex>,
    change: Change,
    /// The number of stages downstream.
    behind: usize,
}

impl Changed for Line<'_> {
    fn change(&mut self) -> &mut Change {
        &mut self.change
    }

    fn fits(&self, other: &Self) -> bool {
        self.stage == other.stage
    }

    fn take(&mut self, other: Self) {
        self.instances.extend(other.instances);
    }
}

/// The causes of all stale stages in a plan.
pub(super) fn text(plan: &Plan<'_>, terminal: Terminal) -> String {
    let lines = lines(plan);
    let names = Names::new(plan.graph);
    let cells = |line: &Line<'_>| {
        let behind = match line.behind {
            0 => String::new(),
            behind => format!("; {} downstream", count(behind, "stage")),
        };
        vec![names.group(&line.instances), format!("{}{behind}", line.change.text())]
    };
    let rows: Vec<Vec<String>> = lines.iter().take(MOST_LINES).map(cells).collect();
    let stale = plan.steps.iter().filter(|(_, verdict)| !matches!(verdict, Verdict::Cached { .. })).count();
    let title = format!("{}, profile {}", plan.graph.pipeline, plan.graph.profile);
    let mut text = terminal.paint(Style::Strong, &title);
    text += &format!(": {} not up to date, {}\n\n", count(stale, "stage"), count(lines.len(), "cause"));
    text += &columns::render(&rows, terminal.width.unwrap_or(usize::MAX), &|_, cell| cell);
    if let Some(more) = lines.len().checked_sub(MOST_LINES).filter(|more| *more > 0) {
        text += &format!("  and {more} more; `--json` has all\n");
    }
    text + "\nname a stage to see its causes\n"
}

fn lines<'g>(plan: &Plan<'g>) -> Vec<Line<'g>> {
    let causes = plan.steps.iter().filter_map(|(index, verdict)| {
        let stage = &plan.graph.stages.node_weight(*index)?.name;
        let reasons = match verdict {
            Verdict::Run { why, .. } => why,
            Verdict::DependsOn { why, .. } if why.iter().any(|why| *why != Reason::New) => why,
            _ => return None,
        };
        Some(Line { stage, instances: vec![*index], change: Change::new(reasons), behind: 0 })
    });
    let mut lines = grouped(causes);
    let line_of =
        lines.iter().enumerate().flat_map(|(at, line)| line.instances.iter().map(move |stage| (*stage, at)));
    let line_of = line_of.collect();
    count_behind(plan, &line_of, &mut lines);
    lines
}

/// Counts the stages downstream of each line. Stages that depend on the same ones share a list, which is visited once.
fn count_behind(plan: &Plan<'_>, line_of: &HashMap<StageIndex, usize>, lines: &mut [Line<'_>]) {
    let mut lists: HashMap<*const StageIndex, (&Arc<[StageIndex]>, usize)> = HashMap::new();
    for (_, verdict) in &plan.steps {
        if let Verdict::DependsOn { stages, .. } = verdict {
            lists.entry(stages.as_ptr()).or_insert((stages, 0)).1 += 1;
        }
    }
    for (stages, count) in lists.into_values() {
        let mut of: Vec<usize> = stages.iter().filter_map(|stage| line_of.get(stage).copied()).collect();
        of.sort_unstable();
        of.dedup();
        of.into_iter().for_each(|line| lines[line].behind += count);
    }
}
