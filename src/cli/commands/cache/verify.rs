//! `dril-pipe cache verify`: hashes every blob and checks every record.

use std::process::ExitCode;

use serde_json::{Value, json};

use crate::cli::args::VerifyArgs;
use crate::cli::commands::inspect::size;
use crate::cli::terminal::{Style, Terminal, count, print, shown};
use crate::error::{Error, exit_codes};
use crate::store::Verified;

pub(in crate::cli) fn main(args: &VerifyArgs) -> Result<ExitCode, Error> {
    let store = super::store(&args.store)?;
    let verified = store.verify(super::key_of, args.repair)?;
    if args.json {
        print(&format!("{:#}\n", as_json(&verified)))?;
    } else {
        print(&text(&verified, args.repair))?;
    }
    let open = verified.damage.len() > verified.repaired;
    Ok(ExitCode::from(if open { exit_codes::CHECK_FAILED } else { exit_codes::OK }))
}

fn text(verified: &Verified, repair: bool) -> String {
    let terminal = Terminal::stdout();
    let mut text = String::new();
    for damage in &verified.damage {
        text += &format!("{} {}\n", shown(damage.path()), damage.text());
    }
    let looked = format!(
        "checked {} ({}) and {}",
        count(verified.blobs, "blob"),
        size(verified.bytes),
        count(verified.records, "record")
    );
    let found = count(verified.damage.len(), "problem");
    text += &match (verified.damage.is_empty(), repair) {
        (true, _) if verified.blobs + verified.records == 0 => "nothing to check\n".to_owned(),
        (true, _) => format!("{}: {looked}\n", terminal.paint(Style::Good, "sound")),
        (false, true) => format!(
            "{}: {looked}; {found}; moved files are in `quarantine-v1` of the cache\n",
            terminal.paint(Style::Notable, "repaired")
        ),
        (false, false) => format!(
            "{}: {looked}; {found}; `--repair` moves the files to quarantine, and the next run rebuilds what it needs\n",
            terminal.paint(Style::Bad, "damaged")
        ),
    };
    text
}

fn as_json(verified: &Verified) -> Value {
    let damage: Vec<Value> = verified
        .damage
        .iter()
        .map(|damage| json!({ "path": damage.path().to_string_lossy(), "what": damage.text() }))
        .collect();
    json!({
        "contents": verified.blobs, "bytes": verified.bytes, "records": verified.records,
        "damage": damage, "repaired": verified.repaired,
    })
}
