//! `dril-pipe watch`: runs a pipeline, and again whenever its file or one of its input files changes.
//!
//! It polls the files a few times per second instead of using file system notifications: there are few of them, and polling
//! works on every file system.

use std::collections::{BTreeMap, BTreeSet};
use std::path::PathBuf;
use std::process::ExitCode;
use std::sync::atomic::Ordering;
use std::time::{Duration, Instant};

use dril_stage_api::Registry;

use super::run;
use crate::cli::args::RunArgs;
use crate::cli::terminal::{Style, Terminal, count, print, print_error, shown};
use crate::cli::{pipeline, report, signals};
use crate::error::{Error, exit_codes};
use crate::fsx;
use crate::plan;
use crate::resolve::{Graph, Origin};
use crate::session::Reading;

/// Polling interval for changed files.
const WATCH_INTERVAL: Duration = Duration::from_millis(200);
/// A change counts once no file has changed for this long: editors write several files, or one in pieces.
const DEBOUNCE: Duration = Duration::from_millis(150);

/// Identity (size, times, inode) of each file; `None` where it does not exist.
type Looks = BTreeMap<PathBuf, Option<String>>;

pub(in crate::cli) fn main(args: &RunArgs, registry: &Registry) -> Result<ExitCode, Error> {
    let stop = signals::stop_flag()?;
    let mut files = files(args, registry);
    loop {
        let (before, began) = (looks(&files), Instant::now());
        // A mistake in the file is reported, and the next edit can correct it.
        if let Err(error) = run::main(args, registry) {
            if args.json {
                print(&report::error_line(&error, began))?;
            }
            print_error(&error.to_string());
        }
        files = self::files(args, registry);
        if !args.quiet && !args.json {
            let terminal = Terminal::stdout();
            let text = format!("watching {}; press Ctrl-C to quit", count(files.len(), "file"));
            print(&format!("{}\n", terminal.paint(Style::Quiet, &text)))?;
        }
        let mut seen = looks(&files);
        // An edit during the run counts, too.
        seen.extend(before.into_iter().filter(|(path, _)| files.contains(path)));
        let changed = loop {
            if stop.load(Ordering::Relaxed) {
                return Ok(ExitCode::from(exit_codes::INTERRUPTED));
            }
            let began = Instant::now();
            if let Some(changed) = changed(&seen) {
                break changed;
            }
            // Thousands of files are polled less often.
            std::thread::sleep(WATCH_INTERVAL.max(began.elapsed() * 10));
        };
        wait_until_quiet(&files);
        if !args.quiet && !args.json {
            print(&format!("\n{} changed\n", shown(&changed)))?;
        }
    }
}

/// The pipeline file, its included files, and its input files, as far as they can be read.
fn files(args: &RunArgs, registry: &Registry) -> Vec<PathBuf> {
    let mut files = vec![args.pipeline.file.clone()];
    let mut reading = Reading::default();
    let source = pipeline::source(&args.pipeline);
    let graph = source.load_with(registry, &mut reading);
    files.extend(reading.parts.into_keys());
    if let Ok(graph) = graph {
        let base = source.base();
        for (path, is_folder, exclude) in outside(&graph) {
            let path = base.join(path);
            if is_folder {
                // Including folders: they change when a file is added or removed.
                for inside in plan::inside(&path, exclude).unwrap_or_default() {
                    let all = inside.path.ancestors().filter(|inside| !inside.as_os_str().is_empty());
                    files.extend(all.map(|inside| path.join(inside)));
                }
            }
            files.push(path);
        }
    }
    files.sort();
    files.dedup();
    files
}

/// The paths of input files and folders (true), with the exclude patterns of folders.
fn outside(graph: &Graph) -> BTreeSet<(&str, bool, &[String])> {
    let sources = graph.stages.node_weights().flat_map(|stage| &stage.inputs).flat_map(|wire| &wire.sources);
    sources
        .filter_map(|source| match &source.from {
            Origin::File { path, folder, exclude, .. } => Some((path.as_str(), *folder, exclude.as_slice())),
            Origin::Stage { .. } => None,
        })
        .collect()
}

fn looks(files: &[PathBuf]) -> Looks {
    files.iter().map(|path| (path.clone(), fsx::identity(path).ok())).collect()
}

/// The first file that has changed.
fn changed(seen: &Looks) -> Option<PathBuf> {
    seen.iter().find(|(path, look)| fsx::identity(path).ok() != **look).map(|(path, _)| path.clone())
}

/// Waits until the files have not changed for [`DEBOUNCE`].
fn wait_until_quiet(files: &[PathBuf]) {
    let mut before = looks(files);
    loop {
        std::thread::sleep(DEBOUNCE);
        let now = looks(files);
        if now == before {
            return;
        }
        before = now;
    }
}
