//! The provenance of every result, and the commands that reproduce it.

use std::collections::BTreeMap;

use dril_stage_api::outcome::{PipelineOutcome, StageOutcome, State};
use maud::{Markup, html};
use serde_json::Value;

use super::{Room, Section, count, duration};

/// Instances shown per stage, at most.
const MOST_INSTANCES: usize = 200;
/// Failed instances whose message is shown, at most.
const MOST_FAILURES: usize = 20;
/// Longer values are truncated.
const LONGEST: usize = 120;
/// Longer messages of failures are truncated.
const LONGEST_MESSAGE: usize = 4_000;

/// All stages, as far as they fit; those that failed first.
pub(crate) fn section(outcome: &PipelineOutcome, room: &mut Room) -> Section {
    let mut groups: Vec<Vec<&StageOutcome>> = Vec::new();
    for stage in &outcome.stages {
        match groups.iter_mut().find(|group| group[0].name == stage.name) {
            Some(group) => group.push(stage),
            None => groups.push(vec![stage]),
        }
    }
    let mut shown: Vec<Option<Markup>> = vec![None; groups.len()];
    for failed in [true, false] {
        for (group, shown) in groups.iter().zip(&mut shown) {
            if group.iter().any(|stage| matches!(stage.state, State::Failed(_))) == failed {
                *shown = Some(stage(group)).filter(|body| room.take(body.0.len()));
            }
        }
    }
    let more = shown.iter().filter(|shown| shown.is_none()).count();
    let body = html! {
        p class="quiet" {
            "For each stage: the parameters that differ from the defaults of its kind, and for each instance its seed, "
            "how long it took, its key and the digests of its outputs. "
            code { "dril-pipe show FILE STAGE" } " prints all of it in full."
        }
        @for body in shown.iter().flatten() { (body) }
        @if more > 0 { p class="quiet" { "and " (count(more, "more stage")) ", which did not fit into this page." } }
    };
    Section { anchor: "provenance", title: "Provenance", body }
}

fn stage(group: &[&StageOutcome]) -> Markup {
    let first = group[0];
    let done = group.iter().filter(|stage| stage.state == State::Done).count();
    let seconds: f64 = group.iter().filter_map(|stage| stage.seconds).sum();
    let failures: Vec<(&str, &str)> = group
        .iter()
        .filter_map(|stage| match &stage.state {
            State::Failed(message) => Some((stage.id.as_str(), message.as_str())),
            _ => None,
        })
        .collect();
    html! {
        details open[!failures.is_empty()] {
            summary {
                (first.name) " "
                span class="quiet" {
                    (first.kind) ", revision " (first.revision) "; "
                    @if group.len() == 1 { (state(&first.state)) } @else { (done) " of " (group.len()) " done" }
                    @if seconds > 0.0 { ", " (duration(seconds)) }
                }
            }
            @for (id, message) in failures.iter().take(MOST_FAILURES) {
                p { code { (id) } ": " } pre tabindex="0" { (cut(message, LONGEST_MESSAGE)) }
            }
            @if failures.len() > MOST_FAILURES {
                p class="quiet" { "and " (count(failures.len() - MOST_FAILURES, "more failure")) "." }
            }
            (parameters(group))
            (instances(group))
        }
    }
}

/// The parameters that differ from the defaults, with all their values over the instances.
fn parameters(group: &[&StageOutcome]) -> Markup {
    let mut values: BTreeMap<&str, Vec<String>> = BTreeMap::new();
    for (name, value) in group.iter().flat_map(|stage| &stage.chosen) {
        let text = text(value);
        let known = values.entry(name).or_default();
        if !known.contains(&text) {
            known.push(text);
        }
    }
    html! {
        @if !values.is_empty() {
            table class="keys" {
                caption { "Parameters" }
                tbody { @for (name, values) in &values {
                    tr { th scope="row" { (name) } td { code { (cut(&values.join(" | "), LONGEST)) } } }
                } }
            }
        }
    }
}

fn instances(group: &[&StageOutcome]) -> Markup {
    let axes: Vec<&str> = group[0].labels.iter().map(|(axis, _)| axis.as_str()).collect();
    // An axis of that name says it already.
    let has_seed = group.iter().any(|stage| stage.seed.is_some()) && !axes.contains(&"seed");
    let more = group.len().saturating_sub(MOST_INSTANCES);
    html! {
        div class="wide" tabindex="0" role="region" aria-label=(format!("Instances of {}", group[0].name)) {
            table class="instances" {
                thead { tr {
                    @for axis in &axes { th scope="col" { (axis) } }
                    th scope="col" { "state" }
                    @if has_seed { th scope="col" class="n" { "seed" } }
                    th scope="col" class="n" { "time" } th scope="col" { "key" } th scope="col" { "outputs" }
                } }
                tbody { @for stage in group.iter().take(MOST_INSTANCES) { tr {
                    @for (_, value) in &stage.labels { td { (value) } }
                    td { (state(&stage.state)) }
                    @if has_seed { td class="n" { @if let Some(seed) = stage.seed { (seed) } } }
                    td class="n" { @if let Some(seconds) = stage.seconds { (duration(seconds)) } }
                    td { code { (stage.key.as_deref().map(short).unwrap_or_default()) } }
                    td { @for (n, output) in stage.outputs.iter().enumerate() {
                        @if n > 0 { ", " } (output.name) " " code { (short(&output.digest)) }
                    } }
                } } }
            }
        }
        @if more > 0 { p class="quiet" { "and " (count(more, "more instance")) "." } }
    }
}

fn state(state: &State) -> &'static str {
    match state {
        State::Done => "up to date",
        State::Running => "running",
        State::Stale => "not run",
        State::Failed(_) => "failed",
        State::Waiting => "waiting",
    }
}

fn text(value: &Value) -> String {
    match value {
        Value::String(text) => text.clone(),
        other => other.to_string(),
    }
}

fn cut(text: &str, longest: usize) -> String {
    if text.chars().count() <= longest {
        return text.to_owned();
    }
    text.chars().take(longest - 1).chain(['…']).collect()
}

/// The first digits of a key or digest.
fn short(hex: &str) -> String {
    hex.chars().take(12).collect()
}

/// The commands that reproduce the results.
pub(crate) fn reproduce(outcome: &PipelineOutcome) -> Section {
    let command = |words: &[&str]| {
        let mut all: Vec<String> = vec!["dril-pipe".to_owned()];
        all.extend(words.iter().map(|word| (*word).to_owned()));
        all.extend(outcome.command.iter().map(|word| quoted(word)));
        all.join(" ")
    };
    let lines = [
        command(&["run"]),
        command(&["plan"]),
        command(&["run", "--check-determinism"]),
        "dril-pipe cache export last".to_owned(),
    ];
    let body = html! {
        p { "Bring everything up to date; see what would run; run everything once more and compare; take the results along:" }
        pre tabindex="0" { @for line in &lines { (line) "\n" } }
    };
    Section { anchor: "reproduce", title: "Reproduce", body }
}

/// A word of a command line, quoted for a shell.
fn quoted(word: &str) -> String {
    let is_plain = |c: char| c.is_alphanumeric() || "-_./=:,@+%".contains(c);
    if !word.is_empty() && word.chars().all(is_plain) {
        return word.to_owned();
    }
    format!("'{}'", word.replace('\'', "'\\''"))
}
