//! `dril-pipe runs`: the runs of the cache, latest first.

use std::process::ExitCode;

use serde_json::{Value, json};

use super::{age, epoch, seconds};
use crate::cli::args::RunsArgs;
use crate::cli::terminal::{Style, Terminal, print, printable};
use crate::cli::{columns, pipeline};
use crate::error::Error;
use crate::store::{PastRun, StageState};

pub(in crate::cli) fn main(args: &RunsArgs) -> Result<ExitCode, Error> {
    let store = pipeline::store(&args.store)?;
    let mut runs = Vec::new();
    for id in store.run_ids()? {
        if runs.len() >= args.limit {
            break;
        }
        let run = store.past_run(&id)?;
        if args.pipeline.as_ref().is_none_or(|name| *name == run.pipeline) {
            runs.push(run);
        }
    }
    if args.json {
        print(&format!("{:#}\n", Value::Array(runs.iter().map(json).collect())))?;
    } else if runs.is_empty() {
        print(&format!("no runs in `{}`\n", printable(&store.root().display().to_string())))?;
    } else {
        print(&table(&runs, Terminal::stdout()))?;
    }
    Ok(ExitCode::SUCCESS)
}

fn table(runs: &[PastRun], terminal: Terminal) -> String {
    let rows: Vec<Vec<String>> = runs
        .iter()
        .map(|run| {
            let title = format!("{}, {}", printable(&run.pipeline), printable(&run.profile));
            vec![run.id.clone(), title, age(run.began), ending(run)]
        })
        .collect();
    columns::render(&rows, terminal.width.unwrap_or(usize::MAX), &|column, cell| match column {
        0 => terminal.paint(Style::Strong, &cell),
        2 => terminal.paint(Style::Quiet, &cell),
        _ => cell,
    })
}

/// How it ended, as text.
fn ending(run: &PastRun) -> String {
    let Some(end) = run.end else {
        let count = |fate| run.stages.values().filter(|stage| stage.fate == fate).count();
        let state = if run.alive { "running" } else { "died" };
        return format!(
            "{state}: {} ran, {} in progress",
            count(StageState::Ran),
            count(StageState::Started)
        );
    };
    let counts = [
        (end.ran, "ran"),
        (end.cached, "cached"),
        (end.failed, "failed"),
        (end.skipped, "skipped"),
        (end.stopped, "not finished"),
    ];
    let counts: Vec<String> = counts
        .into_iter()
        .filter(|(number, _)| *number > 0)
        .map(|(number, word)| format!("{number} {word}"))
        .collect();
    format!("{}: {}, in {}", state(run), counts.join(", "), seconds(end.seconds))
}

fn state(run: &PastRun) -> &'static str {
    match run.end {
        None if run.alive => "running",
        None => "died",
        Some(end) if end.stopped > 0 => "stopped",
        Some(end) if end.failed + end.skipped > 0 => "failed",
        Some(_) => "done",
    }
}

fn json(run: &PastRun) -> Value {
    let mut json = json!({
        "run": run.id, "pipeline": run.pipeline, "profile": run.profile, "began": epoch(run.began),
        "state": state(run), "folder": run.folder.to_string_lossy(),
    });
    if let Some(end) = run.end {
        for (name, number) in [
            ("ran", end.ran),
            ("cached", end.cached),
            ("failed", end.failed),
            ("skipped", end.skipped),
            ("stopped", end.stopped),
        ] {
            json[name] = json!(number);
        }
        json["seconds"] = json!(end.seconds);
    }
    json
}
