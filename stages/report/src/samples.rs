//! Labelled evaluations from a fan-in, and their pooling by some of their labels.

use std::collections::BTreeMap;

use dril_stage_api::{Ctx, FanIns, InputItem, Labels, Problems, StageError, scores};

use crate::inference::standard_error;
use crate::stats::Summary;

/// The name of the input in every kind.
pub(crate) const PORT: &str = "scores";

/// One evaluation: the scores of its episodes, and where it comes from.
#[derive(Clone, Debug)]
pub(crate) struct Sample<'a> {
    pub(crate) item: InputItem<'a>,
    pub(crate) scores: Vec<f64>,
    /// True where the training of the agent that was evaluated diverged.
    pub(crate) diverged: bool,
}

/// The evaluations that share the values of the keys, taken as one.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct Group {
    pub(crate) key: Vec<String>,
    /// All episodes of all its evaluations.
    pub(crate) summary: Summary,
    /// How many evaluations it holds. Each is of a training of its own, as they differ in labels such as a seed.
    pub(crate) evaluations: usize,
    /// The standard error of the mean over the means of the evaluations; `None` for one evaluation.
    pub(crate) error: Option<f64>,
    /// How many of them are of an agent whose training diverged.
    pub(crate) diverged: usize,
}

/// Reads the evaluations at input [`PORT`], in the order of the matrix.
///
/// # Errors
/// A file has no scores, two evaluations have the same labels (most often one evaluation wired twice), or the stage was
/// cancelled.
pub(crate) fn read<'a>(ctx: &Ctx<'a>) -> Result<Vec<Sample<'a>>, StageError> {
    let items = ctx.inputs(PORT);
    if items.is_empty() {
        return Err(StageError::Port(format!(
            "input `{PORT}` is not connected, expected at least one artifact"
        )));
    }
    unique(PORT, &items)?;
    let mut samples = Vec::with_capacity(items.len());
    for item in items {
        ctx.stop_if_cancelled()?;
        samples.push(sample(item)?);
    }
    Ok(samples)
}

/// Reads one evaluation.
///
/// # Errors
/// The file has no scores.
pub(crate) fn sample(item: InputItem<'_>) -> Result<Sample<'_>, StageError> {
    let rows = scores::read(PORT, item.path)?;
    let diverged = rows.iter().any(|row| row.diverged_at_step.is_some());
    Ok(Sample { item, scores: rows.iter().map(|row| row.score).collect(), diverged })
}

/// Refuses two items with the same labels.
pub(crate) fn unique(port: &str, items: &[InputItem<'_>]) -> Result<(), StageError> {
    match twice(port, items.iter().map(|item| item.labels)) {
        Some((second, message)) => Err(StageError::input(port, items[second].path, message)),
        None => Ok(()),
    }
}

/// Reports two artifacts with the same labels, before anything runs.
pub(crate) fn check_unique(port: &str, inputs: &FanIns<'_>, problems: &mut Problems) {
    if let Some((_, message)) = twice(port, inputs.at(port).iter().map(|incoming| incoming.labels)) {
        problems.add("", message);
    }
}

/// The first item whose labels an earlier one has, and what to say of it.
fn twice<'l>(port: &str, all: impl Iterator<Item = &'l Labels>) -> Option<(usize, String)> {
    let mut places = BTreeMap::new();
    for (second, labels) in all.enumerate() {
        let first = *places.entry(labels).or_insert(second);
        if first != second {
            let message = format!(
                "items {} and {} at `{port}` have the same labels ({}), expected each combination once; wire each \
                 stage once, or give the items names, as in `{port}: {{ first: ..., second: ... }}`",
                first + 1,
                second + 1,
                describe(labels)
            );
            return Some((second, message));
        }
    }
    None
}

/// The samples by the values of `keys`, groups and episodes in the order of the samples.
///
/// # Errors
/// A sample without one of the labels (`hint` says how to fix it), or scores too large to average.
pub(crate) fn pool(samples: &[Sample<'_>], keys: &[String], hint: &str) -> Result<Vec<Group>, StageError> {
    let mut pools: Vec<(Vec<String>, Vec<&Sample<'_>>)> = Vec::new();
    for (n, sample) in samples.iter().enumerate() {
        let key = key(n, &sample.item, keys, hint)?;
        match pools.iter_mut().find(|(other, _)| *other == key) {
            Some((_, members)) => members.push(sample),
            None => pools.push((key, vec![sample])),
        }
    }
    pools
        .into_iter()
        .map(|(key, members)| {
            let scores: Vec<f64> = members.iter().flat_map(|sample| &sample.scores).copied().collect();
            let summary = summarise(&scores, &members[0].item)?;
            let means = members.iter().map(|sample| Ok(summarise(&sample.scores, &sample.item)?.mean));
            let error = standard_error(&means.collect::<Result<Vec<_>, StageError>>()?);
            let diverged = members.iter().filter(|sample| sample.diverged).count();
            Ok(Group { key, summary, evaluations: members.len(), error, diverged })
        })
        .collect()
}

/// The summary of scores that [`read`] gave; `item` is named where they are too large.
pub(crate) fn summarise(scores: &[f64], item: &InputItem<'_>) -> Result<Summary, StageError> {
    Summary::of(scores).ok_or_else(|| {
        let labels = describe(item.labels);
        StageError::input(PORT, item.path, format!("the scores ({labels}) are too large to average"))
    })
}

fn key(n: usize, item: &InputItem<'_>, keys: &[String], hint: &str) -> Result<Vec<String>, StageError> {
    let value = |key: &String| {
        item.labels.get(key).cloned().ok_or_else(|| {
            let seen = describe(item.labels);
            let message =
                format!("item {} of this input has no label `{key}`; its labels are {seen}; {hint}", n + 1);
            StageError::input(PORT, item.path, message)
        })
    };
    keys.iter().map(value).collect()
}

/// The labels outside `keys` over which groups were pooled, each with its values in the order of the samples.
pub(crate) fn pooled_over(samples: &[Sample<'_>], keys: &[String]) -> Vec<(String, Vec<String>)> {
    let mut axes: Vec<(String, Vec<String>)> = Vec::new();
    let labels = samples.iter().flat_map(|sample| sample.item.labels);
    for (axis, value) in labels.filter(|(axis, _)| !keys.contains(axis)) {
        match axes.iter_mut().find(|(other, _)| other == axis) {
            Some((_, values)) if values.contains(value) => {}
            Some((_, values)) => values.push(value.clone()),
            None => axes.push((axis.clone(), vec![value.clone()])),
        }
    }
    axes.retain(|(_, values)| values.len() > 1);
    axes
}

/// How many of these evaluations have the same bytes as another one of them.
///
/// # Errors
/// A file cannot be read.
pub(crate) fn twins<'s, 'a: 's>(
    samples: impl IntoIterator<Item = &'s Sample<'a>>,
) -> Result<usize, StageError> {
    let mut files: Vec<(Vec<u8>, usize)> = Vec::new();
    for sample in samples {
        let path = sample.item.path;
        let bytes = std::fs::read(path).map_err(StageError::io("cannot read", path))?;
        match files.iter_mut().find(|(other, _)| *other == bytes) {
            Some((_, count)) => *count += 1,
            None => files.push((bytes, 1)),
        }
    }
    Ok(files.iter().map(|(_, count)| *count).filter(|count| *count > 1).sum())
}

/// `expert=clipped, mode=stochastic`, or `none`.
pub(crate) fn describe(labels: &Labels) -> String {
    if labels.is_empty() {
        return "none".to_owned();
    }
    labels.iter().map(|(axis, value)| format!("{axis}={value}")).collect::<Vec<_>>().join(", ")
}
