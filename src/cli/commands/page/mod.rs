//! The report: `dril-pipe report`, and the end of every run. A stage package writes the page; this module collects its data and
//! writes the file.

mod against;
mod collect;
mod folders;

use std::path::Path;
use std::process::ExitCode;
use std::sync::OnceLock;

use dril_stage_api::outcome::PipelineOutcome;
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

/// The file name of the report in the results folder.
const FILE: &str = "report.html";

/// Renders a report; with the name and the results of another run, it compares both.
pub type Page = fn(&PipelineOutcome, Option<(&str, &PipelineOutcome)>) -> Result<String, StageError>;

/// The function that renders reports, and the first line by which they are recognised.
static WRITER: OnceLock<(Page, &'static str)> = OnceLock::new();

/// Registers the function that renders reports, once, before the program runs; every report starts with `mark`. Without it there
/// are no reports.
pub fn keep_page(page: Page, mark: &'static str) {
    // Only the first call counts; there is one `main`.
    let _ = WRITER.set((page, mark));
}

/// `dril-pipe report`.
pub(in crate::cli) fn main(args: &ReportArgs, registry: &Registry) -> Result<ExitCode, Error> {
    let Some(writer) = WRITER.get() else {
        let text = "this program was built without the stage packages, which are needed for reports";
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

/// Writes the report to the results folder of a run, and prints its path. If it cannot be written, this is only a warning.
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
        let text = format!("`{}` exists and is not a report of this program", file.display());
        return Err(Error::new(ErrorKind::Io, text).hint("move it, or choose another file with `--out`"));
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
