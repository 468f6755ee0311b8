//! Axes that change nothing: instances that differ in such an axis have the same key, whatever runs, and so one result between
//! them. Usually the stage was meant to use the axis: five equal trainings look like five seeds without any spread.

use std::collections::{BTreeSet, HashMap, HashSet};

use super::warning::Warning;
use crate::resolve::{Graph, Origin, Source, StageIndex, StageInstance};

/// The instances of a stage.
type Instances<'g> = Vec<(StageIndex, &'g StageInstance)>;

/// One warning for each stage of `graph` with such an axis, for which `is_shown` is true.
///
/// A stage whose axis matters to some instances only shares results on purpose. One that reads a stage with such an axis has no
/// fault of its own.
pub(super) fn warnings(graph: &Graph, is_shown: &dyn Fn(&str) -> bool) -> Vec<Warning> {
    let mut stages: Vec<Instances<'_>> = Vec::new();
    for index in graph.stages.node_indices() {
        let stage = &graph.stages[index];
        // Instances of a stage are adjacent.
        match stages.last_mut().filter(|instances| instances[0].1.name == stage.name) {
            Some(instances) => instances.push((index, stage)),
            None => stages.push(vec![(index, stage)]),
        }
    }
    let mut equal = Equal { graph, known: HashSet::new() };
    let mut idle: BTreeSet<(&str, &str)> = BTreeSet::new();
    for instances in &stages {
        let first = instances[0].1;
        for (axis, _) in &first.coordinates {
            if is_idle(axis, instances, &mut equal) {
                idle.insert((&first.name, axis));
            }
        }
    }
    let mut warnings = Vec::new();
    for instances in stages.iter().filter(|instances| is_shown(&instances[0].1.name)) {
        let first = instances[0].1;
        let axes = first.coordinates.iter().map(|(axis, _)| axis.as_str());
        let axes: Vec<&str> = axes.filter(|axis| idle.contains(&(&*first.name, *axis))).collect();
        let own: Vec<&str> =
            axes.iter().copied().filter(|axis| !is_inherited(axis, first, graph, &idle)).collect();
        if !own.is_empty() {
            warnings.push(warning(&own, &axes, instances));
        }
    }
    warnings
}

/// True where every two instances that differ only in this axis are equal, and there are two.
fn is_idle<'g>(axis: &str, instances: &Instances<'g>, equal: &mut Equal<'g>) -> bool {
    let (first, others) = match instances.split_first() {
        Some((first, others)) if !others.is_empty() => (first, others),
        _ => return false,
    };
    // Nearly every axis matters to the first two already.
    let rest = without(&[axis], first.1);
    let Some(other) = others.iter().find(|(_, stage)| without(&[axis], stage) == rest) else { return false };
    if !equal.are(first.0, other.0) {
        return false;
    }
    let mut groups: HashMap<Vec<&str>, StageIndex> = HashMap::new();
    instances.iter().all(|(index, stage)| {
        let first = *groups.entry(without(&[axis], stage)).or_insert(*index);
        equal.are(first, *index)
    })
}

/// The values of an instance on the other axes.
fn without<'g>(axes: &[&str], stage: &'g StageInstance) -> Vec<&'g str> {
    let others = stage.coordinates.iter().filter(|(name, _)| !axes.contains(&name.as_str()));
    others.map(|(_, value)| value.as_str()).collect()
}

/// True where a stage that `stage` reads has this axis, too, and does not use it.
fn is_inherited(axis: &str, stage: &StageInstance, graph: &Graph, idle: &BTreeSet<(&str, &str)>) -> bool {
    let sources = stage.inputs.iter().flat_map(|wire| &wire.sources);
    sources.filter_map(|source| producer(source, graph)).any(|from| idle.contains(&(&*from.name, axis)))
}

fn producer<'g>(source: &Source, graph: &'g Graph) -> Option<&'g StageInstance> {
    match &source.from {
        Origin::Stage { stage, .. } => graph.stages.node_weight(*stage),
        Origin::File { .. } => None,
    }
}

/// `own` are the axes to report, among all `axes` that change nothing.
fn warning(own: &[&str], axes: &[&str], instances: &Instances<'_>) -> Warning {
    let stage = instances[0].1;
    let results: BTreeSet<Vec<&str>> = instances.iter().map(|(_, stage)| without(axes, stage)).collect();
    let results = match results.len() {
        1 => "1 result".to_owned(),
        many => format!("{many} results"),
    };
    let names: Vec<String> = own.iter().map(|axis| format!("`{axis}`")).collect();
    let (change, it) = if own.len() == 1 { ("changes", "it") } else { ("change", "them") };
    let (name, count) = (&stage.name, instances.len());
    let uses: Vec<String> = own.iter().map(|axis| format!("`${axis}`")).collect();
    let seed = if !own.contains(&"seed") {
        ""
    } else if stage.kind.is_program() {
        ", as in `seed: $seed` with `{seed}` in the command"
    } else if stage.kind.seeded() {
        ", as in `seed: $seed`"
    } else {
        ""
    };
    Warning {
        message: format!(
            "stage `{name}`: {} {change} nothing, so its {count} instances have {results}",
            names.join(" and ")
        ),
        hint: format!(
            "use {} in its `with`, `seed` or `inputs`{seed}, or remove {it} from its `matrix`",
            uses.join(" and ")
        ),
    }
}

/// Compares instances by everything that enters their keys, without any file or record.
struct Equal<'g> {
    graph: &'g Graph,
    /// Pairs that were found equal.
    known: HashSet<(StageIndex, StageIndex)>,
}

impl Equal<'_> {
    /// True where both have the same key in every run.
    fn are(&mut self, one: StageIndex, other: StageIndex) -> bool {
        let mut open = vec![(one, other)];
        let mut seen = HashSet::new();
        while let Some(pair) = open.pop() {
            if pair.0 == pair.1 || self.known.contains(&pair) || !seen.insert(pair) {
                continue;
            }
            let (one, other) = (&self.graph.stages[pair.0], &self.graph.stages[pair.1]);
            if !alike(one, other, &mut open) {
                return false;
            }
        }
        self.known.extend(seen);
        true
    }
}

/// True where two instances are equal if the pairs that are added to `open` are.
fn alike(one: &StageInstance, other: &StageInstance, open: &mut Vec<(StageIndex, StageIndex)>) -> bool {
    if one.kind.name() != other.kind.name() || one.seed != other.seed || one.params != other.params {
        return false;
    }
    one.inputs.len() == other.inputs.len()
        && one.inputs.iter().zip(&other.inputs).all(|(one, other)| {
            one.port == other.port
                && one.sources.len() == other.sources.len()
                && one.sources.iter().zip(&other.sources).all(|(one, other)| {
                    // Those of an input that takes one are empty.
                    one.labels == other.labels && same_origin(&one.from, &other.from, open)
                })
        })
}

fn same_origin(one: &Origin, other: &Origin, open: &mut Vec<(StageIndex, StageIndex)>) -> bool {
    match (one, other) {
        (Origin::Stage { stage: one, output }, Origin::Stage { stage: other, output: theirs }) => {
            open.push((*one, *other));
            output == theirs
        }
        (Origin::File { key: one, .. }, Origin::File { key: other, .. }) => one == other,
        _ => false,
    }
}
