//! Two runs of a pipeline compared: what was changed, which results differ, and by how much.
//!
//! A is the pipeline as it stands, B the other run. Stages are matched by their keys, whatever they are called, and
//! otherwise by name and coordinates; results with equal digests are equal to the bit.

use std::collections::{BTreeMap, BTreeSet};

use dril_stage_api::outcome::{OutputOutcome, PipelineOutcome, StageOutcome, State};
use dril_stage_api::scores::{self, ScoreRow};
use dril_stage_api::{Artifact, StageError};
use maud::{Markup, html};
use serde_json::Value;

use super::figures::{Member, Missing, SIDE, figure_of, files, frame};
use super::grid::decimals;
use super::{Room, Section, count};
use crate::inference::{FEWEST_EPISODES, half_width, mean};
use crate::number::fixed;

/// Longer lists are cut.
const MOST_ROWS: usize = 200;
/// Longer values are cut.
const LONGEST: usize = 80;

/// A stage that both runs have.
type Pair<'o> = (&'o StageOutcome, &'o StageOutcome);

/// The comparison with the run `name`.
pub(crate) fn section(
    ours: &PipelineOutcome,
    name: &str,
    theirs: &PipelineOutcome,
    room: &mut Room,
) -> Result<Section, StageError> {
    let Matched { pairs, only_a, only_b } = matched(&ours.stages, &theirs.stages);
    let done: Vec<Pair<'_>> =
        pairs.iter().copied().filter(|(a, b)| a.state == State::Done && b.state == State::Done).collect();
    let equal = done.iter().filter(|pair| are_equal(pair)).count();
    let body = html! {
        p {
            "A is this pipeline as it stands (profile " code { (ours.profile) } "), B is "
            code { (name) } " (profile " code { (theirs.profile) } ")."
        }
        dl class="facts" {
            div { dt { "stages in both, done" } dd { (done.len()) } }
            div { dt { "with equal results" } dd { (equal) } }
            div { dt { "with other results" } dd { (done.len() - equal) } }
        }
        (missing("Only in A", &only_a))
        (missing("Only in B", &only_b))
        (missing("Not done in A or B", &undone(&pairs)))
        (renamed(&pairs))
        (changes(&pairs))
        (score_table(&done, &decimals_by_reader(ours))?)
        (curves(&done, room)?)
    };
    Ok(Section { anchor: "compared", title: "Compared with another run", body })
}

/// The stages of both runs.
struct Matched<'o> {
    /// In the order of A.
    pairs: Vec<Pair<'o>>,
    only_a: Vec<&'o str>,
    only_b: Vec<&'o str>,
}

/// Matches stages by their keys first, then by their names. Several stages may have one key, and thus one result: a stage of
/// A that has no other counterpart shares that of another one.
fn matched<'o>(ours: &'o [StageOutcome], theirs: &'o [StageOutcome]) -> Matched<'o> {
    let mut by_key: BTreeMap<&str, Vec<usize>> = BTreeMap::new();
    let mut by_id: BTreeMap<&str, usize> = BTreeMap::new();
    for (at, stage) in theirs.iter().enumerate() {
        by_id.insert(&stage.id, at);
        if let Some(key) = &stage.key {
            by_key.entry(key).or_default().push(at);
        }
    }
    let with_key = |stage: &StageOutcome| {
        stage.key.as_ref().and_then(|key| by_key.get(key.as_str())).map_or(&[][..], Vec::as_slice)
    };
    let mut taken: BTreeSet<usize> = BTreeSet::new();
    let mut partners: Vec<Option<usize>> = vec![None; ours.len()];
    for round in 0..4 {
        for (stage, partner) in ours.iter().zip(&mut partners).filter(|(_, partner)| partner.is_none()) {
            let (all, same) = (with_key(stage), by_id.get(stage.id.as_str()).copied());
            *partner = match round {
                0 => same.filter(|at| all.contains(at)),
                1 => all.iter().copied().find(|at| !taken.contains(at)),
                2 => same.filter(|at| !taken.contains(at)),
                _ => all.first().copied(),
            };
            taken.extend(*partner);
        }
    }
    let known: BTreeSet<&str> = ours.iter().filter_map(|stage| stage.key.as_deref()).collect();
    let is_known = |stage: &StageOutcome| stage.key.as_deref().is_some_and(|key| known.contains(key));
    let (mut pairs, mut only_a) = (Vec::new(), Vec::new());
    for (stage, partner) in ours.iter().zip(partners) {
        match partner {
            Some(at) => pairs.push((stage, &theirs[at])),
            None => only_a.push(stage.id.as_str()),
        }
    }
    let only_b = theirs.iter().enumerate().filter(|(at, stage)| !taken.contains(at) && !is_known(stage));
    Matched { pairs, only_a, only_b: only_b.map(|(_, stage)| stage.id.as_str()).collect() }
}

/// Stages with equal keys that B calls otherwise.
fn renamed(pairs: &[Pair<'_>]) -> Markup {
    let pairs: Vec<&Pair<'_>> = pairs.iter().filter(|(a, b)| a.id != b.id).collect();
    html! {
        @if !pairs.is_empty() {
            details {
                summary { "Other names in B " span class="quiet" { (count(pairs.len(), "stage")) } }
                ul { @for (a, b) in pairs.iter().take(MOST_ROWS) {
                    li { code { (a.id) } " is " code { (b.id) } }
                } }
                (more(pairs.len()))
            }
        }
    }
}

/// True where all outputs that both have are equal.
fn are_equal((a, b): &Pair<'_>) -> bool {
    a.outputs.iter().all(|output| {
        let other = b.outputs.iter().find(|other| other.name == output.name);
        other.is_none_or(|other| other.digest == output.digest)
    })
}

fn undone<'o>(pairs: &[Pair<'o>]) -> Vec<&'o str> {
    let open = pairs.iter().filter(|(a, b)| a.state != State::Done || b.state != State::Done);
    open.map(|(a, _)| a.id.as_str()).collect()
}

fn missing(title: &str, ids: &[&str]) -> Markup {
    html! {
        @if !ids.is_empty() {
            details {
                summary { (title) " " span class="quiet" { (count(ids.len(), "stage")) } }
                ul { @for id in ids.iter().take(MOST_ROWS) { li { code { (id) } } } }
                (more(ids.len()))
            }
        }
    }
}

fn more(rows: usize) -> Markup {
    let left = rows.saturating_sub(MOST_ROWS);
    html! { @if left > 0 { p class="quiet" { "and " (count(left, "more row")) "." } } }
}

/// A change of one stage of the file: its field, and the values of A and B.
type Change = (String, String, String, String);

/// Parameters, seeds and revisions that differ; instances with the same change are one line.
fn changes(pairs: &[Pair<'_>]) -> Markup {
    let mut changes: Vec<(Change, usize)> = Vec::new();
    for (a, b) in pairs {
        let (ours, theirs) = (fields(a), fields(b));
        let names: BTreeSet<&String> = ours.keys().chain(theirs.keys()).collect();
        for name in names {
            let value = |of: &BTreeMap<String, String>| of.get(name).map_or("–", String::as_str).to_owned();
            let (left, right) = (value(&ours), value(&theirs));
            if left == right {
                continue;
            }
            let change = (a.name.clone(), name.clone(), left, right);
            match changes.iter_mut().find(|(known, _)| *known == change) {
                Some((_, count)) => *count += 1,
                None => changes.push((change, 1)),
            }
        }
    }
    html! {
        h3 { "What was changed" }
        @if changes.is_empty() {
            p { "Parameters, seeds and revisions of all stages in both are equal." }
        } @else {
            div class="wide" tabindex="0" role="region" aria-label="What was changed" {
                table {
                    thead { tr {
                        th scope="col" { "stage" } th scope="col" { "field" } th scope="col" { "A" }
                        th scope="col" { "B" } th scope="col" class="n" { "instances" }
                    } }
                    tbody { @for ((stage, field, a, b), count) in changes.iter().take(MOST_ROWS) { tr {
                        th scope="row" { (stage) } td { (field) } td { code { (cut(a)) } } td { code { (cut(b)) } }
                        td class="n" { (count) }
                    } } }
                }
            }
            (more(changes.len()))
        }
    }
}

/// All that enters the key of a stage but its inputs, with dotted names.
fn fields(stage: &StageOutcome) -> BTreeMap<String, String> {
    let mut fields = BTreeMap::new();
    flatten("", &stage.params, &mut fields);
    if let Some(seed) = stage.seed {
        fields.insert("(seed)".to_owned(), seed.to_string());
    }
    fields.insert("(kind)".to_owned(), format!("{} revision {}", stage.kind, stage.revision));
    fields
}

fn flatten(name: &str, value: &Value, into: &mut BTreeMap<String, String>) {
    match value {
        Value::Object(map) if !map.is_empty() => {
            for (field, value) in map {
                let name = if name.is_empty() { field.clone() } else { format!("{name}.{field}") };
                flatten(&name, value, into);
            }
        }
        Value::String(text) => drop(into.insert(name.to_owned(), text.clone())),
        other => drop(into.insert(name.to_owned(), other.to_string())),
    }
}

fn cut(text: &str) -> String {
    if text.chars().count() <= LONGEST {
        return text.to_owned();
    }
    text.chars().take(LONGEST - 1).chain(['…']).collect()
}

/// The outputs of a type that a pair of stages has in common.
fn common<'o>(pair: &Pair<'o>, artifact: Artifact) -> Vec<(&'o OutputOutcome, &'o OutputOutcome)> {
    let ours = pair.0.outputs.iter().filter(|output| output.artifact == artifact);
    let both = |output: &'o OutputOutcome| {
        Some((output, pair.1.outputs.iter().find(|other| other.name == output.name)?))
    };
    ours.filter_map(both).collect()
}

/// One evaluation in both runs.
struct Scored {
    means: [f64; 2],
    /// A − B, and half the width of its 95 % interval.
    difference: (f64, Option<f64>),
    is_paired: bool,
}

impl Scored {
    fn of(a: &[ScoreRow], b: &[ScoreRow]) -> Option<Self> {
        let values = |rows: &[ScoreRow]| rows.iter().map(|row| row.score).collect::<Vec<_>>();
        let (ours, theirs) = (values(a), values(b));
        let means = [mean(&ours)?, mean(&theirs)?];
        let by_seed: BTreeMap<u64, f64> = b.iter().map(|row| (row.seed, row.score)).collect();
        let differences: Vec<f64> =
            a.iter().filter_map(|row| Some(row.score - by_seed.get(&row.seed)?)).collect();
        let is_paired = differences.len() == a.len() && by_seed.len() == b.len() && a.len() == b.len();
        let enough = a.len().min(b.len()) >= FEWEST_EPISODES;
        let half = match is_paired {
            true => half_width(&differences),
            false => half_width(&ours).zip(half_width(&theirs)).map(|(a, b)| (a * a + b * b).sqrt()),
        };
        Some(Self { means, difference: (means[0] - means[1], half.filter(|_| enough)), is_paired })
    }
}

/// The most decimals with which a stage of the pipeline shows the scores of each stage: a run does not say of itself whether
/// its scores are points or accuracies.
fn decimals_by_reader(outcome: &PipelineOutcome) -> BTreeMap<&str, usize> {
    let mut most: BTreeMap<&str, usize> = BTreeMap::new();
    for reader in &outcome.stages {
        let sources = reader.inputs.iter().filter_map(|input| outcome.stages.get(input.stage?));
        for source in sources {
            let known = most.entry(&source.id).or_default();
            *known = (*known).max(decimals(&reader.params));
        }
    }
    most
}

fn score_table(done: &[Pair<'_>], decimals: &BTreeMap<&str, usize>) -> Result<Markup, StageError> {
    let mut rows = Vec::new();
    for pair in done {
        for (ours, theirs) in common(pair, Artifact::SCORES) {
            let scored = if ours.digest == theirs.digest {
                None
            } else {
                let (a, b) = (scores::read("scores", &ours.path)?, scores::read("scores", &theirs.path)?);
                Scored::of(&a, &b)
            };
            rows.push((pair.0.id.as_str(), scored));
        }
    }
    let differ = rows.iter().filter(|(_, scored)| scored.is_some()).count();
    let unpaired = rows.iter().any(|(_, scored)| scored.as_ref().is_some_and(|one| !one.is_paired));
    Ok(html! {
        @if !rows.is_empty() {
            h3 { "Scores" }
            p class="quiet" {
                (differ) " of " (count(rows.len(), "evaluation")) " differ. Differences are A − B over episodes with the "
                "same seed, with their 95 % interval over the episodes: they hold for these policies, not for other "
                "trainings."
                @if unpaired { " Where the seeds differ (*), they are differences of means." }
            }
            div class="wide" tabindex="0" role="region" aria-label="Scores of both runs" {
                table {
                    thead { tr {
                        th scope="col" { "evaluation" } th scope="col" class="n" { "A" } th scope="col" class="n" { "B" }
                        th scope="col" class="n" { "difference" }
                    } }
                    tbody { @for (id, scored) in rows.iter().take(MOST_ROWS) {
                        (score_row(id, scored.as_ref(), 1 + decimals.get(id).copied().unwrap_or(0)))
                    } }
                }
            }
            (more(rows.len()))
        }
    })
}

fn score_row(id: &str, scored: Option<&Scored>, decimals: usize) -> Markup {
    let signed = |value: f64| signed(value, decimals);
    let Some(Scored { means: [a, b], difference: (difference, half), is_paired }) = scored else {
        return html! { tr class="quiet" { td { code { (id) } } td class="n" colspan="3" { "equal to the bit" } } };
    };
    html! {
        tr {
            td { code { (id) } } td class="n" { (signed(*a)) } td class="n" { (signed(*b)) }
            td class="n" {
                @if *difference > 0.0 { "+" } (signed(*difference))
                @if let Some(half) = half { " ± " (fixed(*half, decimals)) }
                @if !is_paired { "*" }
            }
        }
    }
}

/// With the typographic minus sign.
fn signed(value: f64, decimals: usize) -> String {
    fixed(value, decimals).replace('-', "−")
}

/// Training logs that differ, drawn over each other.
fn curves(done: &[Pair<'_>], room: &mut Room) -> Result<Markup, StageError> {
    let mut groups: Vec<(&str, &str, Vec<Member<'_>>)> = Vec::new();
    for pair in done {
        for (ours, theirs) in common(pair, Artifact::TRAINING_LOG) {
            if ours.digest == theirs.digest {
                continue;
            }
            let labels = |side: &str| {
                let side = (SIDE.to_owned(), side.to_owned());
                pair.0.labels.iter().cloned().chain([side]).collect::<Vec<_>>()
            };
            let members = [(labels("A"), ours), (labels("B"), theirs)];
            match groups.iter_mut().find(|(name, port, _)| *name == pair.0.name && *port == ours.name) {
                Some((_, _, known)) => known.extend(members),
                None => groups.push((&pair.0.name, &ours.name, members.into())),
            }
        }
    }
    let (mut bodies, mut missing) = (Vec::new(), Missing::default());
    for (name, port, members) in &groups {
        let title = format!("{name}.{port}");
        if let Some(figure) = missing.keep(title.clone(), figure_of(name, port, members)?, room) {
            bodies.push(html! {
                details open {
                    summary { code { (title) } " " span class="quiet" { (files(members)) } }
                    figure { (frame(&format!("{title} of both runs"), &figure)) }
                }
            });
        }
    }
    Ok(html! {
        @if !groups.is_empty() { h3 { "Training" } @for body in &bodies { (body) } (missing.note()) }
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    fn row(seed: u64, score: f64) -> ScoreRow {
        ScoreRow { episode: 0, seed, score, steps: 1, outcome: "finished".into(), diverged_at_step: None }
    }

    #[test]
    fn equal_seeds_are_pairs_whatever_their_order() {
        let a: Vec<ScoreRow> = (0..40).map(|n| row(n, n as f64 + 1.0)).collect();
        let b: Vec<ScoreRow> = (0..40).rev().map(|n| row(n, n as f64)).collect();
        let scored = Scored::of(&a, &b).unwrap();
        assert!(scored.is_paired);
        assert_eq!(scored.difference, (1.0, Some(0.0)));
        let elsewhere: Vec<ScoreRow> = (100..140).map(|n| row(n, n as f64)).collect();
        assert!(!Scored::of(&a, &elsewhere).unwrap().is_paired);
        assert_eq!(Scored::of(&a[..5], &b[35..]).unwrap().difference.1, None, "too few for an interval");
    }

    #[test]
    fn nested_parameters_have_dotted_names() {
        let mut fields = BTreeMap::new();
        flatten("", &serde_json::json!({ "env": { "car": { "limit": 3 } }, "mode": "mean" }), &mut fields);
        let expected = [("env.car.limit".to_owned(), "3".to_owned()), ("mode".to_owned(), "mean".to_owned())];
        assert_eq!(fields, BTreeMap::from(expected));
    }
}
