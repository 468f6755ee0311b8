//! `dril-pipe cache doctor`: measures whether a file system gives what a cache relies on.

use std::process::ExitCode;
use std::time::Duration;

use serde_json::{Value, json};

use crate::cli::args::DoctorArgs;
use crate::cli::columns;
use crate::cli::terminal::{Style, Terminal, print, printable, shown};
use crate::error::{Error, exit_codes};
use crate::fsx::doctor::{self, Attended, Check, Health};

/// How long a process that attends waits for one that leads.
const PATIENCE: Duration = Duration::from_secs(600);

pub(in crate::cli) fn main(args: &DoctorArgs) -> Result<ExitCode, Error> {
    if args.peer {
        let text = match doctor::attend(&args.folder, PATIENCE)? {
            Attended::Done => {
                "took part in a measurement: the other `dril-pipe cache doctor` shows its results\n"
            }
            Attended::Alone => {
                "no measurement was started in ten minutes; run `dril-pipe cache doctor DIR` on another machine while this command waits\n"
            }
        };
        print(text)?;
        return Ok(ExitCode::SUCCESS);
    }
    let checks = doctor::examine(&args.folder)?;
    if args.json {
        print(&format!("{:#}\n", as_json(&checks)))?;
    } else {
        print(&text(args, &checks))?;
    }
    let fails = checks.iter().any(|check| check.health == Health::Fails);
    Ok(ExitCode::from(if fails { exit_codes::CHECK_FAILED } else { exit_codes::OK }))
}

fn text(args: &DoctorArgs, checks: &[Check]) -> String {
    let terminal = Terminal::stdout();
    let row =
        |check: &Check| vec![check.name.to_owned(), word(check.health).to_owned(), printable(&check.seen)];
    let rows: Vec<Vec<String>> = checks.iter().map(row).collect();
    let style = |health: &str| match health {
        "ok" => Style::Good,
        "degraded" => Style::Notable,
        "fails" => Style::Bad,
        _ => Style::Quiet,
    };
    let mut text = columns::render(&rows, usize::MAX, &|column, cell| match column {
        1 => terminal.paint(style(cell.trim()), &cell),
        _ => cell,
    });
    for check in checks.iter().filter(|check| !check.means.is_empty()) {
        text += &format!("{}: {}\n", check.name, check.means);
    }
    let worst = |health| checks.iter().any(|check| check.health == health);
    let (style, verdict) = if worst(Health::Fails) {
        (Style::Bad, "cannot be used for a cache that is shared")
    } else if worst(Health::Degraded) {
        (Style::Notable, "can be used for a cache, with the limits above")
    } else {
        (Style::Good, "can be used for a cache")
    };
    text + &format!("{}: {verdict}\n", terminal.paint(style, &shown(&args.folder)))
}

fn word(health: Health) -> &'static str {
    match health {
        Health::Ok => "ok",
        Health::Degraded => "degraded",
        Health::Fails => "fails",
        Health::Unknown => "unknown",
    }
}

fn as_json(checks: &[Check]) -> Value {
    let checks = checks.iter().map(|check| {
        json!({ "name": check.name, "health": word(check.health), "seen": check.seen, "means": check.means })
    });
    json!({ "checks": checks.collect::<Vec<_>>() })
}
