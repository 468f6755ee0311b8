//! `run --check-determinism`: runs every stage a second time and reports outputs that differ.

use std::sync::atomic::AtomicBool;
use std::time::Instant;

use serde_json::json;

use crate::cli::args::RunArgs;
use crate::cli::terminal::{Style, Terminal, count, print, print_error, printable, shown};
use crate::cli::{pipeline, report};
use crate::error::{Error, exit_codes};
use crate::exec::{self, Options, RecheckOutcome, Runner};
use crate::plan;
use crate::resolve::Graph;
use crate::store::Store;

/// Runs all stages of a run that started at `began` a second time. Returns the exit code.
pub(in crate::cli) fn main(
    args: &RunArgs,
    graph: &Graph,
    store: &Store,
    runner: &dyn Runner,
    options: &Options,
    stop: &AtomicBool,
    began: Instant,
) -> Result<u8, Error> {
    let terminal = Terminal::stdout();
    let total = graph.stages.node_count();
    let talks = !args.json && !args.quiet;
    if talks {
        print(&format!("checking determinism: running {} again\n", count(total, "stage")))?;
    }
    let plan = plan::plan(graph, store, &pipeline::source(&args.pipeline).base())?;
    let mut number = 0;
    let outcomes = exec::recheck(&plan, store, runner, options, stop, &mut |stage, outcome| {
        number += 1;
        let id = &graph.stages[stage].id;
        if args.json {
            let _ = print(&format!("{}\n", line(id, outcome, began)));
        } else if talks && outcome.is_same() {
            let same = terminal.paint(Style::Good, "same   ");
            let _ =
                print(&format!("[{number:>width$}/{total}] {same} {id}\n", width = total.to_string().len()));
        } else if !outcome.is_same() {
            print_error(&format!("error: stage `{id}` {}\n", text(outcome)));
        }
    })?;
    let bad: Vec<_> = outcomes.iter().filter(|(_, outcome)| !outcome.is_same()).collect();
    let Some((first, outcome)) = bad.first() else {
        if talks {
            let word = terminal.paint(Style::Good, "deterministic");
            print(&format!("{word}: {} produced the same bytes twice\n", count(outcomes.len(), "stage")))?;
        }
        return Ok(exit_codes::OK);
    };
    if bad.iter().any(|(_, outcome)| matches!(outcome, RecheckOutcome::Stopped)) {
        return Ok(exit_codes::INTERRUPTED);
    }
    if talks {
        let word = terminal.paint(Style::Bad, "not deterministic");
        let id = &graph.stages[*first].id;
        print(&format!(
            "{word}: {} of {}; the first is `{id}`, which {}\n",
            bad.len(),
            count(outcomes.len(), "stage"),
            text(outcome)
        ))?;
    }
    Ok(exit_codes::CHECK_FAILED)
}

fn text(outcome: &RecheckOutcome) -> String {
    match outcome {
        RecheckOutcome::Same => "produced the same bytes".to_owned(),
        RecheckOutcome::Differs { output, at, path } => {
            format!(
                "produced a different output `{output}`: the first difference is at byte {at} ({})",
                shown(path)
            )
        }
        RecheckOutcome::Failed(failure) => {
            format!("failed the second time: {}", printable(&failure.to_string()))
        }
        RecheckOutcome::Stopped => "was stopped".to_owned(),
    }
}

fn line(id: &str, outcome: &RecheckOutcome, began: Instant) -> serde_json::Value {
    let at = report::seconds_since(began);
    let mut line = json!({ "event": "checked", "at": at, "stage": id, "same": outcome.is_same() });
    match outcome {
        RecheckOutcome::Differs { output, at, path } => {
            line["output"] = json!(output);
            line["byte"] = json!(at);
            line["path"] = json!(path.to_string_lossy());
        }
        RecheckOutcome::Failed(failure) => line["error"] = json!(failure.to_string()),
        RecheckOutcome::Same | RecheckOutcome::Stopped => {}
    }
    line
}
