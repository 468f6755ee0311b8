//! `dril-pipe log`: the logs of stages, of every instance the newest one or that of a given run.

use std::collections::{BTreeSet, VecDeque};
use std::path::Path;
use std::process::ExitCode;

use serde_json::{Value, json};

use super::logs::{self, Log};
use super::{age, epoch, ids, pick, pick_run};
use crate::cli::args::LogArgs;
use crate::cli::pipeline;
use crate::cli::terminal::{print, print_error, printable, shown};
use crate::error::Error;
use crate::fsx::{self, Entry};

/// So many bytes are printed at once.
const CHUNK: usize = 1 << 16;

pub(in crate::cli) fn main(args: &LogArgs) -> Result<ExitCode, Error> {
    let store = pipeline::store(&args.store)?;
    let given = match &args.run {
        Some(word) => Some(pick_run(&store, word)?),
        None => None,
    };
    let mut output = Output::default();
    let (mut all, mut never) = (Vec::new(), BTreeSet::new());
    for (word, pattern) in args.stages.iter().zip(pick::patterns(&args.stages)?) {
        let logs = match &given {
            Some(run) => logs::of_run(&store, word, &pattern, run)?,
            None => logs::newest(&store, word, &pattern)?,
        };
        let titled = logs.found.len() > 1 || args.stages.len() > 1;
        for (id, log) in &logs.found {
            if args.path {
                output.add(&format!("{}\n", shown(&log.path)));
            } else if args.json {
                all.push(as_json(id, log, args.tail)?);
            } else {
                page(&mut output, id, log, args.tail, titled)?;
            }
        }
        never.extend(logs.never);
    }
    if args.json {
        output.add(&format!("{:#}\n", Value::Array(all)));
    }
    output.end()?;
    if !never.is_empty() {
        let never: Vec<&str> = never.iter().map(String::as_str).collect();
        print_error(&format!("note: no run started {}\n", printable(&ids::groups(&never))));
    }
    Ok(ExitCode::SUCCESS)
}

fn as_json(id: &str, log: &Log, tail: Option<usize>) -> Result<Value, Error> {
    let fate = log.run.stages.get(&log.id).map(|stage| stage.fate.name());
    let mut lines = Vec::new();
    each_line(&log.path, tail, |line| {
        lines.push(line);
        true
    })?;
    Ok(json!({
        "stage": id, "started_as": log.id, "run": log.run.id, "began": epoch(log.run.began), "fate": fate,
        "path": log.path.to_string_lossy(), "lines": lines,
    }))
}

/// Prints a long text in pieces.
#[derive(Default)]
struct Output {
    text: String,
    failed: Option<Error>,
}

impl Output {
    /// False once nothing can be printed any more.
    fn add(&mut self, text: &str) -> bool {
        self.text += text;
        if self.text.len() >= CHUNK && self.failed.is_none() {
            self.failed = print(&self.text).err();
            self.text.clear();
        }
        self.failed.is_none()
    }

    fn end(self) -> Result<(), Error> {
        self.failed.map_or_else(|| print(&self.text), Err)
    }
}

/// The lines of a log, or the last `tail` of them.
fn each_line(path: &Path, tail: Option<usize>, mut each: impl FnMut(String) -> bool) -> Result<(), Error> {
    let Some(tail) = tail else { return Ok(fsx::each_line(path, each)?) };
    let mut last = VecDeque::new();
    fsx::each_line(path, |line| {
        last.push_back(line);
        if last.len() > tail {
            last.pop_front();
        }
        true
    })?;
    last.into_iter().all(&mut each);
    Ok(())
}

fn page(output: &mut Output, id: &str, log: &Log, tail: Option<usize>, titled: bool) -> Result<(), Error> {
    let Log { run, path, .. } = log;
    let Some(stage) = run.stages.get(&log.id) else { return Ok(()) };
    let is_empty = matches!(fsx::entry(path)?, Some(Entry::File(0)));
    let is_renamed = log.id != id;
    if titled || is_empty || is_renamed {
        let nothing = if is_empty { "; the log is empty" } else { "" };
        let name = if is_renamed { format!(" as {}", log.id) } else { String::new() };
        let (fate, began) = (stage.fate.name(), age(run.began));
        output.add(&format!("==> {id}: {fate}{name} in run {}, {began}{nothing}\n", run.id));
    }
    each_line(path, tail, |line| output.add(&(printable(&line).replace('\n', " ") + "\n")))?;
    if let Some(error) = &stage.error {
        output.add(&format!("==> failed: {}\n", printable(error).trim_end()));
    }
    Ok(())
}
