//! `dril-pipe diff`: compares two runs, stage by stage: parameters, inputs and results.

use std::collections::BTreeSet;
use std::process::ExitCode;

use serde_json::{Value, json};

use super::{age, pick, pick_run, seconds, size};
use crate::cli::args::DiffArgs;
use crate::cli::terminal::{Style, Terminal, count, cut, print, printable};
use crate::cli::{pipeline, why};
use crate::error::Error;
use crate::fsx;
use crate::plan::{self, Reason};
use crate::store::{PastRun, Record, Store, Stored};

/// Larger results are compared by digest only.
const LARGEST: u64 = 1 << 20;
/// The number of differing lines of a result that are shown.
const MOST_LINES: usize = 12;
/// The width of one side.
const SIDE: usize = 44;
/// Extensions of results that are text.
const TEXTS: [&str; 5] = ["md", "csv", "txt", "json", "tex"];

pub(in crate::cli) fn main(args: &DiffArgs) -> Result<ExitCode, Error> {
    let store = pipeline::store(&args.store)?;
    let first = store.past_run(&pick_run(&store, &args.first)?)?;
    let second = store.past_run(&pick_run(&store, &args.second)?)?;
    let ids: BTreeSet<&String> = first.stages.keys().chain(second.stages.keys()).collect();
    let patterns = pick::patterns(&args.stages)?;
    let wanted = |id: &str| patterns.is_empty() || patterns.iter().any(|pattern| pattern.means_id(id));
    let mut pairs = Vec::new();
    let mut same = 0;
    for id in ids.into_iter().filter(|id| wanted(id)) {
        let pair = Pair { id, then: side(&store, &first, id)?, now: side(&store, &second, id)? };
        if pair.then.same(&pair.now) { same += 1 } else { pairs.push(pair) }
    }
    if args.json {
        let stages = pairs.iter().map(|pair| pair.json(&store)).collect::<Result<Vec<_>, _>>()?;
        let json = json!({ "first": first.id, "second": second.id, "same": same, "stages": stages });
        print(&format!("{json:#}\n"))?;
    } else {
        print(&text(&store, &first, &second, &pairs, same)?)?;
    }
    Ok(ExitCode::SUCCESS)
}

/// A stage in one of the runs.
struct Side {
    fate: &'static str,
    key: Option<crate::store::Key>,
    record: Option<Record>,
}

/// A stage in both.
struct Pair<'a> {
    id: &'a str,
    then: Side,
    now: Side,
}

fn side(store: &Store, run: &PastRun, id: &str) -> Result<Side, Error> {
    let Some(stage) = run.stages.get(id) else {
        return Ok(Side { fate: "missing", key: None, record: None });
    };
    let record = match stage.key {
        Some(key) => store.record(&key)?,
        None => None,
    };
    Ok(Side { fate: stage.fate.name(), key: stage.key, record })
}

impl Side {
    /// True for the same key and the same outcome; cached or run makes no difference.
    fn same(&self, other: &Self) -> bool {
        self.key == other.key && self.key.is_some() && self.record.is_some() == other.record.is_some()
    }

    fn fate(&self) -> &'static str {
        // For a comparison of results, cached and run are the same.
        if self.record.is_some() { "done" } else { self.fate }
    }
}

impl Pair<'_> {
    fn reasons(&self) -> Vec<Reason> {
        match (&self.then.record, &self.now.record) {
            (Some(then), Some(now)) => plan::compare(then, now),
            _ => Vec::new(),
        }
    }

    /// Output, what it was, what it is; those that differ.
    fn results(&self) -> Vec<(&String, Option<&Stored>, Option<&Stored>)> {
        let (Some(then), Some(now)) = (&self.then.record, &self.now.record) else { return Vec::new() };
        let names: BTreeSet<&String> = then.outputs.keys().chain(now.outputs.keys()).collect();
        let both = names.into_iter().map(|name| (name, then.outputs.get(name), now.outputs.get(name)));
        both.filter(|(_, then, now)| then.map(|it| it.digest) != now.map(|it| it.digest)).collect()
    }

    fn json(&self, store: &Store) -> Result<Value, Error> {
        let side = |side: &Side| {
            json!({
                "fate": side.fate, "key": side.key,
                "seconds": side.record.as_ref().map(|record| record.seconds),
            })
        };
        let mut results = Vec::new();
        for (name, then, now) in self.results() {
            let lines = match (then, now) {
                (Some(then), Some(now)) => lines(store, then, now)?,
                _ => None,
            };
            let lines = lines.map(|lines| {
                let line = |(number, then, now): &Other| json!({ "line": number, "then": then, "now": now });
                lines.iter().map(line).collect::<Vec<_>>()
            });
            results.push(json!({ "output": name, "then": then, "now": now, "lines": lines }));
        }
        let why: Vec<Value> = self.reasons().iter().map(why::json).collect();
        Ok(json!({
            "stage": self.id, "then": side(&self.then), "now": side(&self.now), "why": why, "results": results,
        }))
    }
}

fn text(
    store: &Store,
    first: &PastRun,
    second: &PastRun,
    pairs: &[Pair<'_>],
    same: usize,
) -> Result<String, Error> {
    let terminal = Terminal::stdout();
    let title = |run: &PastRun| {
        format!("{} ({}, {}; {})", run.id, printable(&run.pipeline), printable(&run.profile), age(run.began))
    };
    let mut text = format!("- {}\n+ {}\n", title(first), title(second));
    for pair in pairs {
        text += &format!("\n{}", terminal.paint(Style::Strong, pair.id));
        match (&pair.then.record, &pair.now.record) {
            (Some(then), Some(now)) => {
                text += &format!(": took {}, then {}\n", seconds(then.seconds), seconds(now.seconds));
            }
            _ => text += &format!(": {}, then {}\n", pair.then.fate(), pair.now.fate()),
        }
        let reasons = pair.reasons();
        if !reasons.is_empty() {
            text += &format!("  {}\n", why::text(&reasons));
        }
        for (name, then, now) in pair.results() {
            text += &result(store, name, then, now)?;
        }
        if pair.results().is_empty() && pair.then.record.is_some() && pair.now.record.is_some() {
            text += "  the results are the same\n";
        }
    }
    if !pairs.is_empty() {
        text.push('\n');
    }
    Ok(text + &format!("{} the same, {} different\n", count(same, "stage"), pairs.len()))
}

fn result(store: &Store, name: &str, then: Option<&Stored>, now: Option<&Stored>) -> Result<String, Error> {
    let (Some(then), Some(now)) = (then, now) else {
        return Ok(format!("  result `{name}` is in only one of the runs\n"));
    };
    let short = |stored: &Stored| format!("{} ({})", stored.digest.short(), size(stored.bytes));
    let mut text = format!("  result `{name}`: {} -> {}\n", short(then), short(now));
    let Some(lines) = lines(store, then, now)? else { return Ok(text) };
    let room =
        lines.iter().take(MOST_LINES).map(|(_, then, _)| then.chars().count()).max().unwrap_or(0).min(SIDE);
    for (number, then, now) in lines.iter().take(MOST_LINES) {
        let (then, now) = (cut(&printable(then), SIDE), cut(&printable(now), SIDE));
        text += format!("    {number:>5}  {then:<room$}  |  {now}").trim_end();
        text.push('\n');
    }
    if let Some(more) = lines.len().checked_sub(MOST_LINES).filter(|more| *more > 0) {
        text += &format!("    and {more} more lines\n");
    }
    Ok(text)
}

/// A line that differs: its number, what it was, what it is.
type Other = (usize, String, String);

/// The lines that differ, by number; `None` where the results are no short texts, or are not there any more.
fn lines(store: &Store, then: &Stored, now: &Stored) -> Result<Option<Vec<Other>>, Error> {
    let is_text = |stored: &Stored| stored.bytes <= LARGEST && TEXTS.contains(&&*stored.extension);
    if !is_text(then) || !is_text(now) {
        return Ok(None);
    }
    let read = |stored: &Stored| fsx::read_if_there(&store.blob_path(&stored.digest));
    let (Some(then), Some(now)) = (read(then)?, read(now)?) else { return Ok(None) };
    let (then, now) =
        (String::from_utf8_lossy(&then).into_owned(), String::from_utf8_lossy(&now).into_owned());
    let (then, now): (Vec<&str>, Vec<&str>) = (then.lines().collect(), now.lines().collect());
    let mut found = Vec::new();
    for number in 0..then.len().max(now.len()) {
        let at = |lines: &[&str]| lines.get(number).copied().unwrap_or_default().to_owned();
        if then.get(number) != now.get(number) {
            found.push((number + 1, at(&then), at(&now)));
        }
    }
    Ok(Some(found))
}
