//! `dril-pipe diff`: compares two runs, stage by stage: parameters, inputs and results.

use std::collections::BTreeSet;
use std::process::ExitCode;

use serde_json::{Value, json};

use super::pair::{Pair, Side};
use super::renamed::{self, Renamed};
use super::{age, ids, pick, pick_run, seconds, size};
use crate::cli::args::DiffArgs;
use crate::cli::terminal::{Style, Terminal, count, cut, print, printable};
use crate::cli::{pipeline, why};
use crate::error::Error;
use crate::fsx;
use crate::store::{PastRun, Store, Stored};

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
    for id in ids {
        let pair = Pair::of(id, &store, &first, &second)?;
        match pair.then.same(&pair.now) {
            true => same += usize::from(wanted(id)),
            false => pairs.push(pair),
        }
    }
    let mut renamed = renamed::take(&mut pairs);
    pairs.retain(|pair| wanted(pair.id));
    renamed.retain(|pair| wanted(pair.then) || wanted(pair.now));
    if args.json {
        let stages = pairs.iter().map(|pair| as_json(pair, &store)).collect::<Result<Vec<_>, _>>()?;
        let renamed: Vec<Value> = renamed.iter().map(Renamed::json).collect();
        let json = json!({
            "first": first.id, "second": second.id, "same": same, "renamed": renamed, "stages": stages,
        });
        print(&format!("{json:#}\n"))?;
    } else {
        print(&text(&store, (&first, &second), &renamed, &pairs, same)?)?;
    }
    Ok(ExitCode::SUCCESS)
}

fn as_json(pair: &Pair<'_>, store: &Store) -> Result<Value, Error> {
    let side = |side: &Side| {
        json!({
            "fate": side.fate, "key": side.key,
            "seconds": side.record.as_ref().map(|record| record.seconds),
        })
    };
    let mut results = Vec::new();
    for (name, then, now) in pair.results() {
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
    let why: Vec<Value> = pair.reasons().iter().map(why::json).collect();
    Ok(json!({
        "stage": pair.id, "then": side(&pair.then), "now": side(&pair.now), "why": why, "results": results,
    }))
}

fn text(
    store: &Store,
    (first, second): (&PastRun, &PastRun),
    renamed: &[Renamed<'_>],
    pairs: &[Pair<'_>],
    same: usize,
) -> Result<String, Error> {
    let terminal = Terminal::stdout();
    let title = |run: &PastRun| {
        format!("{} ({}, {}; {})", run.id, printable(&run.pipeline), printable(&run.profile), age(run.began))
    };
    let mut text = format!("- {}\n+ {}\n", title(first), title(second));
    for line in renamed::lines(renamed, |name| terminal.paint(Style::Strong, name)) {
        text += &format!("\n{line}\n");
    }
    // Instances of a stage of which there is nothing more to say share a line.
    let mut groups: Vec<Vec<&Pair<'_>>> = Vec::new();
    for pair in pairs {
        let fates = pair.fates();
        match groups.iter_mut().find(|group| fates.is_some() && group[0].fates() == fates) {
            Some(group) => group.push(pair),
            None => groups.push(vec![pair]),
        }
    }
    for group in &groups {
        let (pair, names) = (group[0], group.iter().map(|pair| pair.id).collect::<Vec<_>>());
        text += &format!("\n{}", terminal.paint(Style::Strong, &ids::group(&names)));
        text += &match pair.fates() {
            Some((_, then, now)) => format!(": {then}, then {now}\n"),
            None => difference(store, pair)?,
        };
    }
    if !groups.is_empty() || !renamed.is_empty() {
        text.push('\n');
    }
    let moved = if renamed.is_empty() { String::new() } else { format!("{} renamed, ", renamed.len()) };
    Ok(text + &format!("{} the same, {moved}{} different\n", count(same, "stage"), pairs.len()))
}

/// How a stage that both runs have finished differs.
fn difference(store: &Store, pair: &Pair<'_>) -> Result<String, Error> {
    let took = |side: &Side| side.record.as_ref().map_or_else(String::new, |record| seconds(record.seconds));
    let mut text = format!(": took {}, then {}\n", took(&pair.then), took(&pair.now));
    let reasons = pair.reasons();
    if !reasons.is_empty() {
        text += &format!("  {}\n", why::text(&reasons));
    }
    let results = pair.results();
    if results.is_empty() {
        text += "  the results are the same\n";
    }
    for (name, then, now) in results {
        text += &result(store, name, then, now)?;
    }
    Ok(text)
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
