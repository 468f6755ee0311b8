//! `dril-pipe cache gc`: removes unused and old results from the cache.

use std::collections::HashSet;
use std::path::Path;
use std::process::ExitCode;

use dril_stage_api::Registry;
use serde_json::{Value, json};

use crate::cli::args::GcArgs;
use crate::cli::commands::inspect::{age, epoch, size};
use crate::cli::terminal::{count, print, printable, shown};
use crate::cli::{columns, pipeline};
use crate::error::{Error, ErrorKind};
use crate::fsx;
use crate::plan::{self, Verdict};
use crate::session::LockFile;
use crate::store::{Key, Store, Sweep, Swept};

/// The number of results in the human-readable list.
const MOST_RESULTS: usize = 20;

pub(in crate::cli) fn main(args: &GcArgs, registry: &Registry) -> Result<ExitCode, Error> {
    let store = super::store(&args.store)?;
    let mut keep = HashSet::new();
    for path in &args.keep {
        keep.extend(kept_by(path, &store, registry)?);
    }
    let wish = Sweep { keep, older_than: args.older_than, max_bytes: args.max_size, dry_run: args.dry_run };
    let swept = store.sweep(&wish)?;
    if args.json {
        print(&format!("{:#}\n", as_json(&swept, args.dry_run)))?;
    } else {
        print(&text(&swept, args.dry_run))?;
    }
    Ok(ExitCode::SUCCESS)
}

/// The keys that a pipeline file needs in any of its profiles, or that a lock file lists.
fn kept_by(path: &Path, store: &Store, registry: &Registry) -> Result<Vec<Key>, Error> {
    if path.extension().is_some_and(|ending| ending == "lock") {
        let text = fsx::read(path)?;
        return Ok(LockFile::parse(&text, path)?.keys());
    }
    let mut keys = Vec::new();
    let source = pipeline::source_of(path);
    for graph in source.load_all_profiles(registry)? {
        let plan = plan::plan(&graph, store, &source.base())?;
        keys.extend(plan.steps.iter().filter_map(|(_, verdict)| match verdict {
            Verdict::Cached { key, .. } => Some(*key),
            _ => None,
        }));
    }
    if keys.is_empty() {
        let text = format!("`{}` has no results in this cache to keep", path.display());
        return Err(Error::new(ErrorKind::Usage, text)
            .hint("nothing was removed; check `--cache`, or run again without `--keep`"));
    }
    Ok(keys)
}

fn text(swept: &Swept, dry_run: bool) -> String {
    let rows: Vec<Vec<String>> = swept
        .records
        .iter()
        .take(MOST_RESULTS)
        .map(|(key, stage, used)| vec![printable(stage), key.short(), format!("used {}", age(*used))])
        .collect();
    let mut text = columns::render(&rows, usize::MAX, &|_, cell| cell);
    if let Some(more) = swept.records.len().checked_sub(MOST_RESULTS).filter(|more| *more > 0) {
        text += &format!("  and {more} more\n");
    }
    let word = if dry_run { "would remove" } else { "removed" };
    text += &format!(
        "{word} {}, {}, {} of checkpoints and {} of logs: {}; {} of blobs remain\n",
        count(swept.records.len(), "result"),
        count(swept.blobs, "blob"),
        count(swept.checkpoints, "folder"),
        count(swept.runs, "run"),
        size(swept.freed),
        size(swept.left),
    );
    if swept.jobs > 0 {
        text += &format!("{word} {} of jobs of a cluster\n", count(swept.jobs, "folder"));
    }
    if swept.in_use > 0 {
        text += &format!("{} remain because a running process uses them\n", count(swept.in_use, "result"));
    }
    for (path, error) in &swept.not_removed {
        text += &format!("could not remove {}: {}\n", shown(path), printable(error));
    }
    if swept.too_much {
        text += "this is still more than `--max-size`: everything that remains is kept or in use\n";
    }
    text
}

fn as_json(swept: &Swept, dry_run: bool) -> Value {
    let records = swept.records.iter();
    let records: Vec<Value> = records
        .map(|(key, stage, used)| json!({ "key": key, "stage": stage, "used": epoch(*used) }))
        .collect();
    let not_removed: Vec<Value> = swept
        .not_removed
        .iter()
        .map(|(path, error)| json!({ "path": path.to_string_lossy(), "error": error }))
        .collect();
    json!({
        "dry_run": dry_run, "results": records, "contents": swept.blobs, "checkpoints": swept.checkpoints,
        "jobs": swept.jobs, "runs": swept.runs, "freed": swept.freed, "left": swept.left, "in_use": swept.in_use,
        "not_removed": not_removed, "too_much": swept.too_much,
    })
}
