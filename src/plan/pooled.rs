//! Sweeps that a table pools: `--set` adds an axis to a stage, and a stage that reads all of its instances may have parameters
//! that name axes, but not the new one. It then treats, say, two learning rates as two trainings of one.

use std::collections::BTreeSet;

use serde_json::Value;

use super::warning::Warning;
use crate::resolve::{Graph, StageInstance};

/// One warning for each sweep with such stages. Of these, only those for which `is_shown` is true.
pub(super) fn warnings(graph: &Graph, is_shown: &dyn Fn(&str) -> bool) -> Vec<Warning> {
    let mut warnings = Vec::new();
    for axis in &graph.sweeps {
        let mut stages: Vec<&str> = Vec::new();
        let mut hint = None;
        let shown = graph.stages.node_weights().filter(|stage| is_shown(&stage.name));
        for stage in shown {
            let Some(labels) = pooled(axis, stage) else { continue };
            if stages.last() != Some(&&*stage.name) {
                stages.push(&stage.name);
            }
            hint = hint.or_else(|| example(stage, axis, &labels));
        }
        if !stages.is_empty() {
            warnings.push(warning(axis, &stages, hint));
        }
    }
    warnings
}

/// The labels of an input with several values of the axis, if the parameters of the stage name some of them and not the axis.
/// Other stages do not care for axes, or read the labels themselves, as a program can.
fn pooled<'g>(axis: &str, stage: &'g StageInstance) -> Option<BTreeSet<&'g str>> {
    if stage.kind.is_program() {
        return None;
    }
    let mut labels = BTreeSet::new();
    for wire in stage.inputs.iter().filter(|wire| wire.many) {
        let values: BTreeSet<_> = wire.sources.iter().filter_map(|source| source.labels.get(axis)).collect();
        if values.len() > 1 {
            labels.extend(wire.sources.iter().flat_map(|source| source.labels.keys().map(String::as_str)));
        }
    }
    let mut named = BTreeSet::new();
    texts(&stage.params, &mut named);
    let is_about_axes = labels.iter().any(|label| named.contains(label));
    (is_about_axes && !named.contains(axis)).then_some(labels)
}

/// All texts and names of fields in a value.
fn texts<'v>(value: &'v Value, found: &mut BTreeSet<&'v str>) {
    match value {
        Value::String(text) => {
            found.insert(text);
        }
        Value::Array(items) => items.iter().for_each(|item| texts(item, found)),
        Value::Object(fields) => {
            for (name, value) in fields {
                found.insert(name);
                texts(value, found);
            }
        }
        Value::Null | Value::Bool(_) | Value::Number(_) => {}
    }
}

/// How to name the axis: in the parameter with the longest list of labels.
fn example(stage: &StageInstance, axis: &str, labels: &BTreeSet<&str>) -> Option<String> {
    let fields = stage.params.as_object()?;
    let lists = fields.iter().filter_map(|(name, value)| {
        let texts: Option<Vec<&str>> = value.as_array()?.iter().map(Value::as_str).collect();
        let texts = texts?;
        let are_labels = !texts.is_empty() && texts.iter().all(|text| labels.contains(text));
        are_labels.then_some((name, texts))
    });
    // Of equal ones the first.
    let (name, mut list) = lists.rev().max_by_key(|(_, list)| list.len())?;
    list.push(axis);
    Some(format!("--set '{}.{name}=[{}]'", stage.name, list.join(", ")))
}

/// The number of stages that are listed.
const LISTED: usize = 8;

/// "`table14`, `table15` and 7 more".
fn listed(stages: &[&str]) -> String {
    let names: Vec<String> = stages.iter().take(LISTED).map(|name| format!("`{name}`")).collect();
    let more = stages.len().saturating_sub(LISTED);
    let more = if more > 0 { format!(" and {more} more") } else { String::new() };
    names.join(", ") + &more
}

fn warning(axis: &str, stages: &[&str], example: Option<String>) -> Warning {
    let list = listed(stages);
    let (message, they) = if stages.len() == 1 {
        let does = "and its parameters do not name this axis, so it treats them alike";
        (format!("stage {list} reads all values of the sweep `{axis}`, {does}"), "it names")
    } else {
        let does = "and their parameters do not name this axis, so they treat them alike";
        (format!("the stages {list} read all values of the sweep `{axis}`, {does}"), "they name")
    };
    let example = example.map(|example| format!(": `{example}`")).unwrap_or_default();
    Warning { message, hint: format!("name the axis where {they} the others{example}") }
}
