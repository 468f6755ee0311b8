//! Compares a stage with its nearest earlier record, and two records with each other.

use std::collections::BTreeMap;

use serde_json::Value;

use super::lookup::{self, Done};
use super::{OutsideFile, Reason};
use crate::resolve::{Graph, Source, StageInstance, Wire};
use crate::store::{Record, RecordInput, RecordItem};

/// The differences as far as they are known: inputs whose stages are not done are skipped. Empty where nothing differs.
pub fn differences(
    graph: &Graph,
    stage: &StageInstance,
    then: &Record,
    done: &Done,
    files: &BTreeMap<String, OutsideFile>,
) -> Vec<Reason> {
    let mut found = Vec::new();
    if then.kind != stage.kind.name() {
        found.push(Reason::Kind { old: then.kind.clone(), new: stage.kind.name().to_owned() });
        return found;
    }
    if then.revision != stage.kind.revision() {
        found.push(Reason::Revision { old: then.revision, new: stage.kind.revision() });
    }
    let seed = stage.seed.map(|seed| seed.0);
    if then.seed != seed {
        found.push(Reason::Seed { old: then.seed, new: seed });
    }
    params("", Some(&then.params), Some(&stage.params), &mut found);
    let known = Known { graph, done, files };
    for wire in &stage.inputs {
        let before = then.inputs.iter().find(|input| input.port == wire.port);
        known.input(stage, wire, before, &mut found);
    }
    for gone in then.inputs.iter().filter(|input| stage.inputs.iter().all(|wire| wire.port != input.port)) {
        let items = gone.items.iter();
        found.extend(items.map(|item| gone_item(&gone.port, item)));
    }
    found
}

fn gone_item(port: &str, item: &RecordItem) -> Reason {
    Reason::Input { port: port.to_owned(), from: item.from.clone(), old: Some(item.digest), new: None }
}

/// The differences between two records, as reasons of the later one; empty where they have the same key.
pub fn compare(then: &Record, now: &Record) -> Vec<Reason> {
    let mut found = Vec::new();
    if then.kind != now.kind {
        found.push(Reason::Kind { old: then.kind.clone(), new: now.kind.clone() });
    } else if then.revision != now.revision {
        found.push(Reason::Revision { old: then.revision, new: now.revision });
    }
    if then.seed != now.seed {
        found.push(Reason::Seed { old: then.seed, new: now.seed });
    }
    params("", Some(&then.params), Some(&now.params), &mut found);
    let none = Vec::new();
    let items = |record: &'_ Record, port: &str| {
        record.inputs.iter().find(|input| input.port == port).map(|input| input.items.clone())
    };
    let mut ports: Vec<&str> =
        then.inputs.iter().chain(&now.inputs).map(|input| input.port.as_str()).collect();
    ports.sort_unstable();
    ports.dedup();
    for port in ports {
        let before = items(then, port).unwrap_or_else(|| none.clone());
        let after = items(now, port).unwrap_or_else(|| none.clone());
        for item in &after {
            let old = before.iter().find(|other| other.labels == item.labels);
            let (port, from, new) = (port.to_owned(), item.from.clone(), Some(item.digest));
            match old {
                Some(old) if old.digest == item.digest && old.executable == item.executable => {}
                Some(old) if old.digest == item.digest => {
                    found.push(Reason::Rights { port, from, executable: item.executable });
                }
                old => found.push(Reason::Input { port, from, old: old.map(|old| old.digest), new }),
            }
        }
        let gone = before.iter().filter(|item| after.iter().all(|other| other.labels != item.labels));
        found.extend(gone.map(|item| gone_item(port, item)));
    }
    found
}

/// Compares parameters value by value.
fn params(path: &str, then: Option<&Value>, now: Option<&Value>, found: &mut Vec<Reason>) {
    let below = |name: &str| if path.is_empty() { name.to_owned() } else { format!("{path}.{name}") };
    match (then, now) {
        (Some(Value::Object(then)), Some(Value::Object(now))) => {
            let mut names: Vec<&String> = then.keys().chain(now.keys()).collect();
            names.sort_unstable();
            names.dedup();
            for name in names {
                params(&below(name), then.get(name), now.get(name), found);
            }
        }
        (Some(Value::Array(then)), Some(Value::Array(now))) if then.len() == now.len() => {
            for (position, pair) in then.iter().zip(now).enumerate() {
                params(&below(&position.to_string()), Some(pair.0), Some(pair.1), found);
            }
        }
        (then, now) if then != now => found.push(Reason::Param {
            path: path.to_owned(),
            old: then.map(Value::to_string),
            new: now.map(Value::to_string),
        }),
        _ => {}
    }
}

struct Known<'a> {
    graph: &'a Graph,
    done: &'a Done,
    files: &'a BTreeMap<String, OutsideFile>,
}

impl Known<'_> {
    /// Compares the artifacts of one input. Artifacts of a fan-in are matched by their labels, so that a new artifact in the
    /// middle does not look like a change of all that follow.
    fn input(
        &self,
        stage: &StageInstance,
        wire: &Wire,
        before: Option<&RecordInput>,
        found: &mut Vec<Reason>,
    ) {
        let before: &[RecordItem] = before.map_or(&[], |input| &input.items);
        let port = || wire.port.to_owned();
        let mut changed = false;
        for source in &wire.sources {
            let Some(digest) = lookup::digest_of(source, self.done, self.files) else {
                changed = true;
                continue;
            };
            let place = |item: &&RecordItem| same_place(wire, source, item);
            let executable = lookup::is_executable(stage, source, self.done, self.files);
            let mut same = before.iter().filter(place).filter(|item| item.digest == digest).peekable();
            let from = || lookup::origin(self.graph, source);
            if same.peek().is_none() {
                changed = true;
                let old = before.iter().find(place).map(|item| item.digest);
                found.push(Reason::Input { port: port(), from: from(), old, new: Some(digest) });
            } else if same.all(|item| item.executable != executable) {
                changed = true;
                found.push(Reason::Rights { port: port(), from: from(), executable });
            }
        }
        for item in before {
            if !wire.sources.iter().any(|source| same_place(wire, source, item)) {
                changed = true;
                found.push(gone_item(wire.port, item));
            }
        }
        let count = wire.sources.len();
        if !changed && (count != before.len() || wire.many && self.reordered(wire, before)) {
            let from = format!("the order or number of its {count} artifacts");
            found.push(Reason::Input { port: port(), from, old: None, new: None });
        }
    }

    fn reordered(&self, wire: &Wire, before: &[RecordItem]) -> bool {
        wire.sources.iter().zip(before).any(|(source, item)| {
            source.labels != item.labels
                || lookup::digest_of(source, self.done, self.files) != Some(item.digest)
        })
    }
}

/// True where an artifact has the position in the input that `item` had.
fn same_place(wire: &Wire, source: &Source, item: &RecordItem) -> bool {
    !wire.many || source.labels == item.labels
}
