//! `run --check-determinism`: every stage once more, and the first output that is not what it was.

use std::sync::atomic::AtomicBool;

use serde_json::json;

use super::args::RunArgs;
use super::pipeline;
use super::terminal::{Style, Terminal, count, print, print_error, printable, shown};
use crate::error::{Error, exit_codes};
use crate::exec::{self, Again, ChildRunner, Options};
use crate::plan;
use crate::resolve::Graph;
use crate::store::Store;

/// Runs all stages of a finished run once more. The exit code.
pub(super) fn main(
    args: &RunArgs,
    graph: &Graph,
    store: &Store,
    runner: &ChildRunner,
    options: &Options,
    stop: &AtomicBool,
) -> Result<u8, Error> {
    let terminal = Terminal::stdout();
    let total = graph.stages.node_count();
    let talks = !args.json && !args.quiet;
    if talks {
        print(&format!("checking: {} once more\n", count(total, "stage")))?;
    }
    let plan = plan::plan(graph, store, &pipeline::base(&args.pipeline))?;
    let mut number = 0;
    let told = exec::check(&plan, store, runner, options, stop, &mut |stage, again| {
        number += 1;
        let id = &graph.stages[stage].id;
        if args.json {
            let _ = print(&format!("{}\n", line(id, again)));
        } else if talks && *again == Again::Same {
            let same = terminal.paint(Style::Good, "same   ");
            let _ =
                print(&format!("[{number:>width$}/{total}] {same} {id}\n", width = total.to_string().len()));
        } else if *again != Again::Same {
            print_error(&format!("error: stage `{id}` {}\n", text(again)));
        }
    })?;
    let bad: Vec<_> = told.iter().filter(|(_, again)| *again != Again::Same).collect();
    let Some((first, again)) = bad.first() else {
        if talks {
            let word = terminal.paint(Style::Good, "deterministic");
            print(&format!("{word}: {} gave the same bytes twice\n", count(told.len(), "stage")))?;
        }
        return Ok(exit_codes::OK);
    };
    if bad.iter().any(|(_, again)| *again == Again::Stopped) {
        return Ok(exit_codes::INTERRUPTED);
    }
    if talks {
        let word = terminal.paint(Style::Bad, "not deterministic");
        let id = &graph.stages[*first].id;
        print(&format!(
            "{word}: {} of {}; the first is `{id}`, which {}\n",
            bad.len(),
            count(told.len(), "stage"),
            text(again)
        ))?;
    }
    Ok(exit_codes::CHECK_FAILED)
}

fn text(again: &Again) -> String {
    match again {
        Again::Same => "gave the same".to_owned(),
        Again::Differs { output, at, path } => {
            format!("gave another output `{output}`: byte {at} is the first that differs ({})", shown(path))
        }
        Again::Failed(error) => format!("failed the second time: {}", printable(error)),
        Again::Stopped => "was stopped".to_owned(),
    }
}

fn line(id: &str, again: &Again) -> serde_json::Value {
    let mut line = json!({ "event": "checked", "stage": id, "same": *again == Again::Same });
    match again {
        Again::Differs { output, at, path } => {
            line["output"] = json!(output);
            line["byte"] = json!(at);
            line["path"] = json!(path.to_string_lossy());
        }
        Again::Failed(error) => line["error"] = json!(error),
        Again::Same | Again::Stopped => {}
    }
    line
}
