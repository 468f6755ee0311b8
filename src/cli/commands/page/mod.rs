//! The page about a pipeline's results: `dril-pipe report`, and the end of every run. A stage package writes the page;
//! here its facts are collected, and its file is kept.

mod against;
mod collect;

use std::path::Path;
use std::process::ExitCode;
use std::sync::OnceLock;

use dril_stage_api::outcome::Outcome;
use dril_stage_api::{Registry, StageError};

use crate::cli::args::{PipelineArgs, ReportArgs, RunArgs};
use crate::cli::pipeline;
use crate::cli::terminal::{print, print_error, shown};
use crate::error::{Error, ErrorKind};
use crate::fsx;
use crate::resolve::Graph;
use crate::session;
use crate::store::Store;
use against::Other;

/// The name of the page in the results folder.
const FILE: &str = "report.html";

/// Writes a page; with the name and the results of another run, it compares both.
pub type Page = fn(&Outcome, Option<(&str, &Outcome)>) -> Result<String, StageError>;

/// What writes pages, and the line by which it knows its own.
static WRITER: OnceLock<(Page, &'static str)> = OnceLock::new();

/// Names what writes pages, once, before the program runs; every page begins with `mark`. Without it there are none.
pub fn keep_page(page: Page, mark: &'static str) {
    // The first one stays; there is one `main`.
    let _ = WRITER.set((page, mark));
}

/// `dril-pipe report`.
pub(in crate::cli) fn main(args: &ReportArgs, registry: &Registry) -> Result<ExitCode, Error> {
    let Some(writer) = WRITER.get() else {
        let text = "this program was built without the stage packages, and one of them writes reports";
        return Err(Error::new(ErrorKind::Usage, text));
    };
    let graph = pipeline::source(&args.pipeline).load(registry)?;
    let store = pipeline::store(&args.store)?;
    let file = args.out.clone().unwrap_or_else(|| session::default_folder(&graph).join(FILE));
    let other = args.against.as_deref().map(|word| Other::load(word, &store, registry)).transpose()?;
    write(*writer, &args.pipeline, (&graph, &store), &file, other.as_ref())?;
    print(&format!("report: {}\n", shown(&file)))?;
    Ok(ExitCode::SUCCESS)
}

/// Writes the page into the results folder of a run, and says where. That it cannot be written costs no result: it is
/// said, and that is all.
pub(in crate::cli) fn after_run(args: &RunArgs, graph: &Graph, store: &Store, folder: &Path) {
    let Some(writer) = WRITER.get() else { return };
    let file = folder.join(FILE);
    match write(*writer, &args.pipeline, (graph, store), &file, None) {
        Ok(()) if args.quiet || args.json => {}
        Ok(()) => drop(print(&format!("report: {}\n", shown(&file)))),
        Err(error) => print_error(&format!("warning: no report was written: {error}\n")),
    }
}

fn write(
    (page, mark): (Page, &'static str),
    args: &PipelineArgs,
    (graph, store): (&Graph, &Store),
    file: &Path,
    other: Option<&Other>,
) -> Result<(), Error> {
    let old = fsx::read_if_there(file)?;
    if old.as_ref().is_some_and(|old| !old.starts_with(mark.as_bytes())) {
        let text = format!("`{}` is there, and no report of this program", file.display());
        return Err(Error::new(ErrorKind::Io, text).hint("move it away, or give another file with `--out`"));
    }
    let folder = file.parent().filter(|folder| !folder.as_os_str().is_empty()).unwrap_or(Path::new("."));
    let outcome = collect::outcome(args, graph, store, folder)?;
    let text = page(&outcome, other.map(|other| (other.name.as_str(), &other.outcome)))
        .map_err(|error| Error::new(ErrorKind::Io, format!("cannot write a report: {error}")))?;
    if old.as_deref() != Some(text.as_bytes()) {
        fsx::create_dir_all(folder)?;
        fsx::write_atomic(file, text.as_bytes())?;
    }
    Ok(())
}
