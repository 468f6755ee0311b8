//! Selects the instances of a stage that an input reference means, and their output.

use std::collections::{BTreeMap, BTreeSet};

use dril_stage_api::{Arity, Input, Labels, Output};

use super::axes::{Axis, AxisValue};
use super::expand::{Expanded, Instance};
use super::reference::{Reference, Selector, Word};
use crate::spec::problem::Problem;
use crate::spec::source::Span;
use crate::spec::suggest;

/// The consumer of a reference: one input of one instance.
#[derive(Clone, Copy)]
pub(super) struct Consumer<'a> {
    pub stage: &'a str,
    pub input: &'a Input,
    /// Axis and value of the instance.
    pub coordinates: &'a [(&'a str, &'a AxisValue)],
}

impl Consumer<'_> {
    /// True where several instances can be taken.
    fn takes_many(&self) -> bool {
        self.input.arity == Arity::Many
    }
}

/// A selector with its `$name` resolved: the labels that it allows, or all.
pub(super) struct Chosen<'t> {
    pub axis: Word<'t>,
    pub axis_at: Span,
    /// Labels with their places; `None` for `*`.
    pub labels: Option<Vec<(String, Span)>>,
}

impl<'t> Chosen<'t> {
    /// A selector that takes all values.
    pub fn all(selector: &Selector<'t>, axis_at: Span) -> Self {
        Self { axis: selector.axis.clone(), axis_at, labels: None }
    }
}

/// The numbers of the selected instances of `producer`, in matrix order; empty where its matrix excludes them. `at` is the place
/// of the whole reference.
pub(super) fn instances(
    producer: &Expanded<'_>,
    chosen: &[Chosen<'_>],
    consumer: &Consumer<'_>,
    at: Span,
) -> Result<Vec<usize>, Vec<Problem>> {
    let mut problems = unknown_axes(producer, chosen);
    let mut allowed: Vec<Vec<usize>> = Vec::new();
    let mut open: Vec<&Axis> = Vec::new();
    for axis in producer.axes() {
        match positions(axis, producer, chosen, consumer, at) {
            Ok(Some(positions)) => allowed.push(positions),
            Ok(None) => open.push(axis),
            Err(problem) => problems.push(problem),
        }
    }
    // A misspelt axis leaves the intended one without a selector; that is not reported again.
    if !open.is_empty() && problems.is_empty() {
        problems.push(unaddressed(producer, &open, !chosen.is_empty(), consumer, at));
    }
    if !problems.is_empty() {
        return Err(problems);
    }
    Ok(producer.grid.as_ref().map(|grid| grid.select(&allowed)).unwrap_or_default())
}

fn unknown_axes(producer: &Expanded<'_>, chosen: &[Chosen<'_>]) -> Vec<Problem> {
    let mut problems = Vec::new();
    let mut seen: BTreeMap<&str, Span> = BTreeMap::new();
    for selector in chosen {
        let name = selector.axis.text;
        if producer.axes().iter().all(|axis| &*axis.name != name) {
            let axes = producer.axes().iter().map(|axis| &*axis.name);
            problems.push(
                Problem::new(selector.axis_at, format!("stage `{}` has no axis `{name}`", producer.name()))
                    .hint(suggest::hint(name, "its axes", axes)),
            );
        }
        if let Some(first) = seen.insert(name, selector.axis_at) {
            problems.push(
                Problem::new(selector.axis_at, format!("the axis `{name}` is selected twice"))
                    .maybe_related(Some(first), "first")
                    .hint("write alternatives as `axis=a|b`"),
            );
        }
    }
    problems
}

/// The positions on one axis; `None` where the input takes one and nothing selects it.
fn positions(
    axis: &Axis,
    producer: &Expanded<'_>,
    chosen: &[Chosen<'_>],
    consumer: &Consumer<'_>,
    at: Span,
) -> Result<Option<Vec<usize>>, Problem> {
    let everything = || Some((0..axis.values().len()).collect());
    if let Some(selector) = chosen.iter().find(|selector| selector.axis.text == &*axis.name) {
        let Some(labels) = &selector.labels else { return Ok(everything()) };
        let found: Result<BTreeSet<usize>, Problem> = labels
            .iter()
            .map(|(label, at)| axis.position(label).ok_or_else(|| no_value(axis, producer, label, *at)))
            .collect();
        return Ok(Some(found?.into_iter().collect()));
    }
    if let Some((_, value)) = consumer.coordinates.iter().find(|(name, _)| *name == &*axis.name) {
        let position = axis.position(&value.label).ok_or_else(|| {
            no_value(axis, producer, &value.label, at).hint(format!(
                "stage `{}` has that value, and by default takes the same one from stage `{}`",
                consumer.stage,
                producer.name()
            ))
        });
        return Ok(Some(vec![position?]));
    }
    Ok(if consumer.takes_many() { everything() } else { None })
}

fn no_value(axis: &Axis, producer: &Expanded<'_>, label: &str, at: Span) -> Problem {
    let label = crate::spec::node::shorten(label);
    Problem::new(at, format!("stage `{}` has no instance with `{}={label}`", producer.name(), axis.name))
        .hint(suggest::hint(&label, "its values", axis.values().iter().map(|value| &*value.label)))
}

fn unaddressed(
    producer: &Expanded<'_>,
    open: &[&Axis],
    more: bool,
    consumer: &Consumer<'_>,
    at: Span,
) -> Problem {
    let names: Vec<String> = open.iter().map(|axis| format!("`{}`", axis.name)).collect();
    let example: Vec<String> =
        open.iter().map(|axis| format!("{}={}", axis.name, axis.values()[0].label)).collect();
    let message = format!(
        "input `{}` of stage `{}` takes one artifact, but nothing selects the {} of stage `{}`",
        consumer.input.name,
        consumer.stage,
        names.join(" and "),
        producer.name()
    );
    let hint = format!(
        "select one, as in `{}[{}{}]`, or add {} to the matrix of `{}`",
        producer.name(),
        if more { "..., " } else { "" },
        example.join(", "),
        names.join(" and "),
        consumer.stage
    );
    open.iter()
        .fold(Problem::new(at, message), |problem, axis| {
            problem.hint(format!("the values of `{}` are {}", axis.name, axis.list()))
        })
        .hint(hint)
}

/// The output of `instance` that `reference` selects.
pub(super) fn output<'i>(
    instance: &'i Instance,
    producer: &Expanded<'_>,
    reference: &Reference<'_>,
    consumer: &Consumer<'_>,
    at: Span,
) -> Result<&'i Output, Problem> {
    let outputs = &instance.ports.outputs;
    let wanted = consumer.input.artifact;
    if let Some(name) = &reference.output {
        let Some(output) = instance.ports.find_output(name.text) else {
            let known = outputs.iter().map(|output| output.name);
            return Err(Problem::new(
                at,
                format!("stage `{}` has no output `{}`", producer.name(), name.text),
            )
            .hint(suggest::hint(name.text, "its outputs", known)));
        };
        return if output.artifact.fits(wanted) {
            Ok(output)
        } else {
            Err(wrong_type(&[output], producer, consumer, at))
        };
    }
    let exact: Vec<&Output> = outputs.iter().filter(|output| output.artifact == wanted).collect();
    let fitting: Vec<&Output> = outputs.iter().filter(|output| output.artifact.fits(wanted)).collect();
    match (exact.as_slice(), fitting.as_slice()) {
        ([one], _) | ([], [one]) => Ok(one),
        ([], []) => Err(wrong_type(&outputs.iter().collect::<Vec<_>>(), producer, consumer, at)),
        ([], several) | (several, _) => Err(ambiguous(several, producer, consumer, at)),
    }
}

fn wrong_type(outputs: &[&Output], producer: &Expanded<'_>, consumer: &Consumer<'_>, at: Span) -> Problem {
    let gives: Vec<String> = outputs
        .iter()
        .map(|output| format!("`{}.{}` is `{}`", producer.name(), output.name, output.artifact))
        .collect();
    let input = consumer.input;
    Problem::new(
        at,
        format!(
            "input `{}` of stage `{}` takes an artifact of type `{}`, but {}",
            input.name,
            consumer.stage,
            input.artifact,
            gives.join(" and ")
        ),
    )
    .hint(format!(
        "connect an output of type `{}`; `dril-pipe kinds` lists the inputs and outputs of each kind",
        input.artifact
    ))
}

fn ambiguous(several: &[&Output], producer: &Expanded<'_>, consumer: &Consumer<'_>, at: Span) -> Problem {
    let names: Vec<String> =
        several.iter().map(|output| format!("`{}.{}`", producer.name(), output.name)).collect();
    Problem::new(
        at,
        format!(
            "stage `{}` has {} outputs that fit input `{}` of stage `{}`, and nothing selects one",
            producer.name(),
            several.len(),
            consumer.input.name,
            consumer.stage
        ),
    )
    .hint(format!("write {}", names.join(" or ")))
}

/// Axis = value of an instance, for an input that takes many.
pub(super) fn labels(producer: &Expanded<'_>, instance: usize, name: Option<&str>) -> Labels {
    let coordinates = producer.coordinates(instance).into_iter();
    let mut labels: Labels =
        coordinates.map(|(axis, value)| (axis.to_owned(), value.label.to_string())).collect();
    if let Some(name) = name {
        labels.insert("name".to_owned(), name.to_owned());
    }
    labels
}
