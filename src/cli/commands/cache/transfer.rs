//! `dril-pipe cache export` and `import`: a run with its results and provenance as one archive, and back.

use std::path::PathBuf;
use std::process::ExitCode;

use serde_json::{Value, json};

use crate::cli::args::{ExportArgs, ImportArgs};
use crate::cli::commands::inspect::{pick_run, size};
use crate::cli::pipeline;
use crate::cli::terminal::{count, print, print_error, printable, shown};
use crate::error::{Error, ErrorKind, exit_codes};
use crate::fsx;
use crate::store::StoreError;

pub(super) fn export(args: &ExportArgs) -> Result<ExitCode, Error> {
    let store = pipeline::store(&args.store)?;
    let run = store.past_run(&pick_run(&store, &args.run)?)?;
    let safe = |text: &str| text.replace(|c: char| !c.is_alphanumeric() && !"._-".contains(c), "_");
    let name = || PathBuf::from(format!("{}-{}.crate.zip", safe(&run.pipeline), safe(&run.profile)));
    let path = args.out.clone().unwrap_or_else(name);
    let (records, blobs) = store.export(&run, &path).map_err(|error| match error {
        StoreError::NotWhole(text) => {
            Error::new(ErrorKind::Io, format!("cannot export run {}: {text}", run.id))
                .hint("only a complete run can be exported; `dril-pipe runs` lists the runs")
        }
        other => other.into(),
    })?;
    let bytes = match fsx::entry(&path)? {
        Some(fsx::Entry::File(bytes)) => bytes,
        _ => 0,
    };
    if args.json {
        let json = json!({
            "archive": path, "run": run.id, "results": records, "contents": blobs, "bytes": bytes,
        });
        print(&format!("{json:#}\n"))?;
        return Ok(ExitCode::SUCCESS);
    }
    let (records, blobs) = (count(records, "result"), count(blobs, "blob"));
    print(&format!("{}: run {} with {records} and {blobs}, {}\n", shown(&path), run.id, size(bytes)))?;
    Ok(ExitCode::SUCCESS)
}

pub(super) fn import(args: &ImportArgs) -> Result<ExitCode, Error> {
    let store = pipeline::store(&args.store)?;
    let imported = store.import_archive(&args.archive, super::key_of)?;
    if args.json {
        let refused: Vec<Value> = imported
            .refused
            .iter()
            .map(|refusal| json!({ "name": refusal.name, "why": refusal.why }))
            .collect();
        let json = json!({
            "results": imported.records, "known": imported.known, "contents": imported.blobs, "refused": refused,
        });
        print(&format!("{json:#}\n"))?;
    } else {
        let known = if imported.known > 0 {
            format!(", {} already in the cache", imported.known)
        } else {
            String::new()
        };
        let (records, blobs) = (count(imported.records, "result"), count(imported.blobs, "blob"));
        print(&format!("imported {records} and {blobs} from {}{known}\n", shown(&args.archive)))?;
    }
    for refusal in &imported.refused {
        print_error(&format!("error: did not import `{}`: {}\n", printable(&refusal.name), refusal.why));
    }
    let code = if imported.refused.is_empty() { exit_codes::OK } else { exit_codes::CHECK_FAILED };
    Ok(ExitCode::from(code))
}
