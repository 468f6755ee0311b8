//! `dril-pipe explain` without a stage: one line per cause, with the number of stages downstream.

use std::collections::HashMap;
use std::sync::Arc;

use crate::cli::names::Names;
use crate::cli::terminal::{Style, Terminal, count};
use crate::cli::{columns, why};
use crate::plan::{Plan, Reason, Verdict};
use crate::resolve::StageIndex;

/// The number of lines; `--json` has all.
const MOST_LINES: usize = 200;

/// One cause: instances of a stage that differ in the same way.
struct Line {
    instances: Vec<StageIndex>,
    why: String,
    /// The number of stages downstream.
    behind: usize,
}

/// The causes of all stale stages in a plan.
pub(super) fn text(plan: &Plan<'_>, terminal: Terminal) -> String {
    let lines = lines(plan);
    let names = Names::new(plan.graph);
    let cells = |line: &Line| {
        let behind = match line.behind {
            0 => String::new(),
            behind => format!("; {} downstream", count(behind, "stage")),
        };
        vec![names.group(&line.instances), format!("{}{behind}", line.why)]
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

fn lines<'g>(plan: &Plan<'g>) -> Vec<Line> {
    let mut places: HashMap<(&'g str, String), usize> = HashMap::new();
    let mut lines: Vec<Line> = Vec::new();
    let mut line_of: HashMap<StageIndex, usize> = HashMap::new();
    for (index, verdict) in &plan.steps {
        let Some(stage) = plan.graph.stages.node_weight(*index) else { continue };
        let reasons = match verdict {
            Verdict::Run { why, .. } => why,
            Verdict::DependsOn { why, .. } if why.iter().any(|why| *why != Reason::New) => why,
            _ => continue,
        };
        let why = why::text(reasons);
        let at = *places.entry((&stage.name, why.clone())).or_insert(lines.len());
        if at == lines.len() {
            lines.push(Line { instances: Vec::new(), why, behind: 0 });
        }
        lines[at].instances.push(*index);
        line_of.insert(*index, at);
    }
    count_behind(plan, &line_of, &mut lines);
    lines
}

/// Counts the stages downstream of each line. Stages that depend on the same ones share a list, which is visited once.
fn count_behind(plan: &Plan<'_>, line_of: &HashMap<StageIndex, usize>, lines: &mut [Line]) {
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
