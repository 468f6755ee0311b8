//! `dril-pipe log`: the log of a stage, of the latest run that started it or of a given run.

use std::process::ExitCode;

use serde_json::{Value, json};

use super::{age, epoch, pick, pick_run};
use crate::cli::args::LogArgs;
use crate::cli::pipeline;
use crate::cli::terminal::{print, printable, shown};
use crate::error::{Error, ErrorKind};
use crate::fsx;
use crate::resolve::Pattern;
use crate::store::{PastRun, StageState, Store};

/// The default number of lines.
const LINES: usize = 10_000;

pub(in crate::cli) fn main(args: &LogArgs) -> Result<ExitCode, Error> {
    let store = pipeline::store(&args.store)?;
    let given = match &args.run {
        Some(word) => Some(pick_run(&store, word)?),
        None => None,
    };
    let mut text = String::new();
    let mut all = Vec::new();
    for (word, pattern) in args.stages.iter().zip(pick::patterns(&args.stages)?) {
        let (run, stages) = find(&store, word, &pattern, given.as_deref())?;
        for id in &stages {
            let Some(path) = run.log_of(id) else { continue };
            let lines = fsx::tail(&path, args.tail.unwrap_or(LINES), usize::MAX)?;
            if args.path {
                text += &format!("{}\n", shown(&path));
            } else if args.json {
                let fate = run.stages.get(id).map(|stage| stage.fate.name());
                all.push(json!({
                    "stage": id, "run": run.id, "began": epoch(run.began), "fate": fate,
                    "path": path.to_string_lossy(), "lines": lines,
                }));
            } else {
                text += &page(&run, id, &lines, stages.len() > 1 || args.stages.len() > 1);
            }
        }
    }
    if args.json {
        text = format!("{:#}\n", Value::Array(all));
    }
    print(&text)?;
    Ok(ExitCode::SUCCESS)
}

fn page(run: &PastRun, id: &str, lines: &[String], titled: bool) -> String {
    let Some(stage) = run.stages.get(id) else { return String::new() };
    let mut text = String::new();
    if titled || lines.is_empty() {
        let nothing = if lines.is_empty() { "; the log is empty" } else { "" };
        text += &format!("==> {id}: {} in run {}, {}{nothing}\n", stage.fate.name(), run.id, age(run.began));
    }
    for line in lines {
        text += &printable(line).replace('\n', " ");
        text.push('\n');
    }
    if let Some(error) = &stage.error {
        text += &format!("==> failed: {}\n", printable(error).trim_end());
    }
    text
}

/// The latest run that started a stage of that name, and the stages.
fn find(
    store: &Store,
    word: &str,
    pattern: &Pattern<'_>,
    given: Option<&str>,
) -> Result<(PastRun, Vec<String>), Error> {
    let ids = match given {
        Some(id) => vec![id.to_owned()],
        None => store.run_ids()?,
    };
    for id in ids {
        let run = store.past_run(&id)?;
        let started = |fate: StageState| {
            matches!(fate, StageState::Ran | StageState::Failed | StageState::Started | StageState::Stopped)
        };
        let stages = run.stages.iter().filter(|(id, stage)| started(stage.fate) && pattern.means_id(id));
        let stages: Vec<String> = stages.map(|(id, _)| id.clone()).collect();
        if !stages.is_empty() {
            return Ok((run, stages));
        }
    }
    let place = given.map_or_else(|| format!("in `{}`", store.root().display()), |id| format!("as run {id}"));
    Err(Error::new(ErrorKind::Usage, format!("no run {place} started a stage `{word}`"))
        .hint("`dril-pipe runs` lists the runs, `dril-pipe status FILE` the stages of a pipeline"))
}
