//! `dril-pipe status`: which stages are fresh, stale, running or failed, with their age and duration.

use std::collections::BTreeMap;
use std::process::ExitCode;
use std::time::{Duration, SystemTime};

use dril_stage_api::Registry;
use serde_json::{Value, json};

use super::{age, epoch, pick_stages};
use crate::cli::args::StatusArgs;
use crate::cli::names::Names;
use crate::cli::terminal::{Style, Terminal, count, duration, estimate, print, printable};
use crate::cli::{columns, pipeline};
use crate::error::Error;
use crate::plan::{self, Estimates, Plan, Verdict};
use crate::resolve::StageIndex;
use crate::store::{Key, PastRun, StageOfRun, StageState, Store};

/// The number of past runs that are searched for failures.
const RUNS: usize = 20;

pub(in crate::cli) fn main(args: &StatusArgs, registry: &Registry) -> Result<ExitCode, Error> {
    let graph = pipeline::source(&args.look.pipeline).load(registry)?;
    let store = pipeline::store(&args.look.store)?;
    let picked = pick_stages(&graph, &args.look.stages)?;
    let plan = plan::plan(&graph, &store, &pipeline::source(&args.look.pipeline).base())?;
    let estimates = Estimates::of(&plan, &store)?;
    let past = Past::of(&plan, &store)?;
    let mut lines = Vec::new();
    for stage in picked {
        lines.push(line(&plan, &store, &estimates, &past, stage)?);
    }
    if args.look.json {
        let all: Vec<Value> = lines.iter().map(|line| line.json(&plan)).collect();
        print(&format!("{:#}\n", Value::Array(all)))?;
    } else {
        print(&table(&plan, &lines, args.all, Terminal::stdout()))?;
    }
    Ok(ExitCode::SUCCESS)
}

/// The state of a stage.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
enum State {
    Fresh,
    Running,
    Failed,
    Stale,
    Behind,
}

impl State {
    fn name(self) -> &'static str {
        match self {
            Self::Fresh => "fresh",
            Self::Running => "running",
            Self::Failed => "failed",
            Self::Stale => "stale",
            Self::Behind => "behind",
        }
    }
}

/// One stage.
struct Line {
    stage: StageIndex,
    state: State,
    /// When it was built, started or failed.
    since: Option<SystemTime>,
    /// Its duration, or an estimate.
    takes: Option<Duration>,
    error: Option<String>,
}

impl Line {
    fn json(&self, plan: &Plan<'_>) -> Value {
        json!({
            "stage": *plan.graph.stages[self.stage].id, "state": self.state.name(),
            "since": self.since.map(epoch), "seconds": self.takes.map(|takes| takes.as_secs_f64()),
            "error": self.error,
        })
    }
}

/// What past runs of this pipeline show about stages that are not done.
struct Past {
    runs: Vec<PastRun>,
}

impl Past {
    fn of(plan: &Plan<'_>, store: &Store) -> Result<Self, Error> {
        let mut runs = Vec::new();
        let stale = plan.steps.iter().any(|(_, verdict)| !matches!(verdict, Verdict::Cached { .. }));
        if stale {
            for id in store.run_ids()?.into_iter().take(RUNS) {
                let run = store.past_run(&id)?;
                if run.pipeline == plan.graph.pipeline && run.profile == plan.graph.profile {
                    runs.push(run);
                }
            }
        }
        Ok(Self { runs })
    }

    /// The latest entry of a stage with that key in such a state.
    fn latest(&self, key: &Key, is: impl Fn(StageState) -> bool) -> Option<(&PastRun, &StageOfRun)> {
        self.runs.iter().find_map(|run| {
            let mut stages = run.stages.values();
            stages.find(|stage| stage.key == Some(*key) && is(stage.fate)).map(|stage| (run, stage))
        })
    }
}

fn line(
    plan: &Plan<'_>,
    store: &Store,
    estimates: &Estimates,
    past: &Past,
    stage: StageIndex,
) -> Result<Line, Error> {
    let mut line =
        Line { stage, state: State::Behind, since: None, takes: estimates.stage(stage), error: None };
    match plan.verdict(stage) {
        Some(Verdict::Cached { key, .. }) => {
            line.state = State::Fresh;
            line.since = store.made_at(key)?;
            let record = store.record(key)?;
            line.takes = record.and_then(|record| Duration::try_from_secs_f64(record.seconds).ok());
        }
        Some(Verdict::Run { key, .. }) if store.is_being_made(key) => {
            line.state = State::Running;
            let started = past.latest(key, |fate| fate == StageState::Started);
            line.since = started.map(|(run, stage)| run.time(stage.at));
        }
        Some(Verdict::Run { key, .. }) => {
            line.state = State::Stale;
            // A try that was stopped or killed says nothing about whether it would have failed again.
            if let Some((run, failed)) = past.latest(key, StageState::was_started)
                && failed.fate == StageState::Failed
            {
                line.state = State::Failed;
                line.since = Some(run.time(failed.at));
                line.error.clone_from(&failed.error);
            }
        }
        _ => {}
    }
    Ok(line)
}

fn table(plan: &Plan<'_>, lines: &[Line], all: bool, terminal: Terminal) -> String {
    let names = Names::new(plan.graph);
    let mut groups: Vec<Vec<&Line>> = Vec::new();
    for line in lines {
        let name = &plan.graph.stages[line.stage].name;
        let alike = |group: &Vec<&Line>| {
            let first = group[0];
            plan.graph.stages[first.stage].name == *name
                && first.state == line.state
                && first.error == line.error
        };
        match groups.iter_mut().find(|group| !all && alike(group)) {
            Some(group) => group.push(line),
            None => groups.push(vec![line]),
        }
    }
    let row = |group: &Vec<&Line>| {
        let stages: Vec<StageIndex> = group.iter().map(|line| line.stage).collect();
        vec![names.group(&stages), group[0].state.name().to_owned(), words(group)]
    };
    let rows: Vec<Vec<String>> = groups.iter().map(row).collect();
    let paint = |column, cell: String| match (column, cell.trim_end()) {
        (1, "fresh") => terminal.paint(Style::Good, &cell),
        (1, "failed") => terminal.paint(Style::Bad, &cell),
        (1, "running" | "stale") => terminal.paint(Style::Notable, &cell),
        (1, _) => terminal.paint(Style::Quiet, &cell),
        _ => cell,
    };
    let title = format!("{}, profile {}", plan.graph.pipeline, plan.graph.profile);
    let mut text = format!("{}: {}\n\n", terminal.paint(Style::Strong, &title), count(lines.len(), "stage"));
    text += &columns::render(&rows, terminal.width.unwrap_or(usize::MAX), &paint);
    text + "\n" + &summary(lines) + "\n"
}

/// Ages and durations of stages in the same state.
fn words(group: &[&Line]) -> String {
    let mut times: Vec<SystemTime> = group.iter().filter_map(|line| line.since).collect();
    times.sort_unstable();
    let mut text = match (times.first(), times.last(), group[0].state) {
        (Some(first), Some(last), state) => {
            let word = match state {
                State::Fresh => "made ",
                State::Running => "began ",
                _ => "",
            };
            let (oldest, newest) = (age(*first), age(*last));
            if oldest == newest {
                format!("{word}{newest}")
            } else {
                format!("{word}{} to {oldest}", newest.trim_end_matches(" ago"))
            }
        }
        (_, _, State::Behind) => "known once the stages upstream have run".to_owned(),
        _ => String::new(),
    };
    let takes: Vec<Duration> = group.iter().filter_map(|line| line.takes).collect();
    if !takes.is_empty() {
        let sum: Duration = takes.iter().sum();
        let comma = if text.is_empty() { "" } else { ", " };
        let time = if group[0].state == State::Fresh {
            format!("took {}", duration(sum))
        } else {
            format!("takes about {}", estimate(sum))
        };
        text += &format!("{comma}{time}");
    }
    if let Some(error) = &group[0].error {
        text += &format!(": {}", printable(error.lines().next().unwrap_or_default()));
    }
    text
}

fn summary(lines: &[Line]) -> String {
    let mut counts: BTreeMap<State, (usize, Duration)> = BTreeMap::new();
    for line in lines {
        let entry = counts.entry(line.state).or_default();
        entry.0 += 1;
        entry.1 += line.takes.unwrap_or_default();
    }
    let parts: Vec<String> = counts
        .into_iter()
        .map(|(state, (number, time))| match state {
            _ if time.is_zero() => format!("{number} {}", state.name()),
            State::Fresh => format!("{number} {} ({} of work)", state.name(), duration(time)),
            _ => format!("{number} {} (about {})", state.name(), estimate(time)),
        })
        .collect();
    parts.join(", ")
}
