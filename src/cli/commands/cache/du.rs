//! `dril-pipe cache du`: disk usage of the cache, by folder and by stage.

use std::process::ExitCode;

use serde_json::json;

use crate::cli::args::DuArgs;
use crate::cli::columns;
use crate::cli::commands::inspect::size;
use crate::cli::terminal::{count, print, printable, shown};
use crate::error::Error;

/// The number of stages in the human-readable list.
const MOST_STAGES: usize = 25;

pub(in crate::cli) fn main(args: &DuArgs) -> Result<ExitCode, Error> {
    let store = super::store(&args.store)?;
    let usage = store.usage()?;
    let mut stages: Vec<_> = usage.stages.iter().collect();
    stages.sort_by_key(|(name, room)| (std::cmp::Reverse(room.bytes), *name));
    if args.json {
        let folders = usage.folders.iter();
        let folders =
            folders.map(|(name, room)| json!({ "folder": name, "files": room.files, "bytes": room.bytes }));
        let stages = stages.iter().map(|((kind, stage), room)| {
            json!({ "stage": stage, "kind": kind, "records": room.files, "bytes": room.bytes })
        });
        let json = json!({
            "bytes": usage.bytes(), "folders": folders.collect::<Vec<_>>(), "stages": stages.collect::<Vec<_>>(),
            "unnamed": { "files": usage.unnamed.files, "bytes": usage.unnamed.bytes },
        });
        print(&format!("{json:#}\n"))?;
        return Ok(ExitCode::SUCCESS);
    }
    let folders = usage.folders.iter();
    let rows: Vec<Vec<String>> =
        folders.map(|(name, room)| vec![name.clone(), size(room.bytes), count(room.files, "file")]).collect();
    let mut text = format!("{}: {}\n\n", shown(store.root()), size(usage.bytes()));
    text += &columns::render(&rows, usize::MAX, &|_, cell| cell);
    let mut rows: Vec<Vec<String>> = Vec::new();
    for ((kind, stage), room) in stages.iter().take(MOST_STAGES) {
        rows.push(vec![printable(stage), kind.clone(), size(room.bytes), count(room.files, "record")]);
    }
    if let Some(more) = stages.len().checked_sub(MOST_STAGES).filter(|more| *more > 0) {
        rows.push(vec![format!("and {more} more stages"), String::new(), String::new(), String::new()]);
    }
    if usage.unnamed.files > 0 {
        let what = "files from outside, leftovers".to_owned();
        rows.push(vec![what, String::new(), size(usage.unnamed.bytes), count(usage.unnamed.files, "blob")]);
    }
    if !rows.is_empty() {
        text += "\nby stage:\n";
        text += &columns::render(&rows, usize::MAX, &|_, cell| cell);
    }
    print(&text)?;
    Ok(ExitCode::SUCCESS)
}
