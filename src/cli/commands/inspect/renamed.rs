//! Stages that have the same results under other names, as after an axis was renamed: `diff` names them once.

use std::collections::{BTreeMap, HashSet};

use serde_json::{Value, json};

use super::ids;
use super::pair::{Pair, Side};
use crate::store::Digest;

/// A stage with two names.
pub(super) struct Renamed<'a> {
    /// In the first run.
    pub then: &'a str,
    /// In the second one.
    pub now: &'a str,
    /// False where only the results are the same.
    same_key: bool,
}

impl Renamed<'_> {
    pub fn json(&self) -> Value {
        json!({ "then": self.then, "now": self.now, "same_key": self.same_key })
    }
}

/// Removes the pairs of which one run has the one and the other run the other, with the same result: first by key, then instances
/// of one stage by their outputs.
pub(super) fn take<'a>(pairs: &mut Vec<Pair<'a>>) -> Vec<Renamed<'a>> {
    let mut found = matched(pairs, |_, side: &Side| side.record.as_ref().and(side.key), true);
    found.extend(matched(pairs, Outputs::of, false));
    found.sort_unstable_by_key(|pair| pair.then);
    found
}

fn matched<'a, T: Ord>(
    pairs: &mut Vec<Pair<'a>>,
    result: impl Fn(&'a str, &Side) -> Option<T>,
    same_key: bool,
) -> Vec<Renamed<'a>> {
    let mut gone: BTreeMap<T, Vec<&'a str>> = BTreeMap::new();
    // Backwards, so that of equal ones the first is taken first.
    for pair in pairs.iter().rev().filter(|pair| pair.now.is_missing()) {
        if let Some(result) = result(pair.id, &pair.then) {
            gone.entry(result).or_default().push(pair.id);
        }
    }
    let came = pairs.iter().filter(|pair| pair.then.is_missing());
    let found: Vec<Renamed<'a>> = came
        .filter_map(|pair| {
            let then = gone.get_mut(&result(pair.id, &pair.now)?)?.pop()?;
            Some(Renamed { then, now: pair.id, same_key })
        })
        .collect();
    let names: HashSet<&str> = found.iter().flat_map(|pair| [pair.then, pair.now]).collect();
    pairs.retain(|pair| !names.contains(pair.id));
    found
}

/// What an instance of a stage has made.
#[derive(PartialEq, Eq, PartialOrd, Ord)]
struct Outputs<'a> {
    stage: &'a str,
    kind: String,
    digests: Vec<(String, Digest)>,
}

impl<'a> Outputs<'a> {
    fn of(id: &'a str, side: &Side) -> Option<Self> {
        let record = side.record.as_ref()?;
        let digests = record.outputs.iter().map(|(name, stored)| (name.clone(), stored.digest)).collect();
        Some(Self { stage: ids::parts(id).0, kind: record.kind.clone(), digests })
    }
}

/// One line for each stage, with its name painted.
pub(super) fn lines(renamed: &[Renamed<'_>], paint: impl Fn(&str) -> String) -> Vec<String> {
    let mut groups: BTreeMap<_, Vec<&Renamed<'_>>> = BTreeMap::new();
    for pair in renamed {
        groups
            .entry((ids::parts(pair.then).0, ids::parts(pair.now).0, !pair.same_key))
            .or_default()
            .push(pair);
    }
    groups.into_iter().map(|((then, now, _), group)| line(then == now, &group, &paint)).collect()
}

fn line(same_stage: bool, group: &[&Renamed<'_>], paint: &dyn Fn(&str) -> String) -> String {
    let first = group[0];
    let results =
        if first.same_key { "the results are the same" } else { "other keys, but the results are the same" };
    let example = format!("{} -> {}", first.then, first.now);
    if group.len() == 1 {
        return format!("{}: renamed; {results}", paint(&example));
    }
    let before = ids::group(&group.iter().map(|pair| pair.then).collect::<Vec<_>>());
    let after = ids::group(&group.iter().map(|pair| pair.now).collect::<Vec<_>>());
    let name = if same_stage { before } else { format!("{before} -> {after}") };
    format!("{}: renamed, {example} and so on; {results}", paint(&name))
}
