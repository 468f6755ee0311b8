//! `dril-pipe log`: the log of a stage, of the latest run that started it or of a given run.

use std::collections::VecDeque;
use std::path::Path;
use std::process::ExitCode;

use serde_json::{Value, json};

use super::{age, epoch, pick, pick_run};
use crate::cli::args::LogArgs;
use crate::cli::pipeline;
use crate::cli::terminal::{print, printable, shown};
use crate::error::{Error, ErrorKind};
use crate::fsx::{self, Entry};
use crate::resolve::Pattern;
use crate::store::{PastRun, Store};

/// So many bytes are printed at once.
const CHUNK: usize = 1 << 16;

pub(in crate::cli) fn main(args: &LogArgs) -> Result<ExitCode, Error> {
    let store = pipeline::store(&args.store)?;
    let given = match &args.run {
        Some(word) => Some(pick_run(&store, word)?),
        None => None,
    };
    let mut output = Output::default();
    let mut all = Vec::new();
    for (word, pattern) in args.stages.iter().zip(pick::patterns(&args.stages)?) {
        let (run, stages) = find(&store, word, &pattern, given.as_deref())?;
        for id in &stages {
            let Some(path) = run.log_of(id) else { continue };
            if args.path {
                output.add(&format!("{}\n", shown(&path)));
            } else if args.json {
                let fate = run.stages.get(id).map(|stage| stage.fate.name());
                let mut lines = Vec::new();
                each_line(&path, args.tail, |line| {
                    lines.push(line);
                    true
                })?;
                all.push(json!({
                    "stage": id, "run": run.id, "began": epoch(run.began), "fate": fate,
                    "path": path.to_string_lossy(), "lines": lines,
                }));
            } else {
                let titled = stages.len() > 1 || args.stages.len() > 1;
                page(&mut output, &run, (id, &path), args.tail, titled)?;
            }
        }
    }
    if args.json {
        output.add(&format!("{:#}\n", Value::Array(all)));
    }
    output.end()?;
    Ok(ExitCode::SUCCESS)
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

fn page(
    output: &mut Output,
    run: &PastRun,
    (id, path): (&str, &Path),
    tail: Option<usize>,
    titled: bool,
) -> Result<(), Error> {
    let Some(stage) = run.stages.get(id) else { return Ok(()) };
    let is_empty = matches!(fsx::entry(path)?, Some(Entry::File(0)));
    if titled || is_empty {
        let nothing = if is_empty { "; the log is empty" } else { "" };
        let (fate, began) = (stage.fate.name(), age(run.began));
        output.add(&format!("==> {id}: {fate} in run {}, {began}{nothing}\n", run.id));
    }
    each_line(path, tail, |line| output.add(&(printable(&line).replace('\n', " ") + "\n")))?;
    if let Some(error) = &stage.error {
        output.add(&format!("==> failed: {}\n", printable(error).trim_end()));
    }
    Ok(())
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
        let stages = run.stages.iter().filter(|(id, stage)| stage.fate.was_started() && pattern.means_id(id));
        let stages: Vec<String> = stages.map(|(id, _)| id.clone()).collect();
        if !stages.is_empty() {
            return Ok((run, stages));
        }
    }
    let place = given.map_or_else(|| format!("in `{}`", store.root().display()), |id| format!("as run {id}"));
    Err(Error::new(ErrorKind::Usage, format!("no run {place} started a stage `{word}`"))
        .hint("`dril-pipe runs` lists the runs, `dril-pipe status FILE` the stages of a pipeline"))
}
