//! The layer `interval`: one line for each category, with mean, 95 % interval and published value.

use std::path::Path;

use dril_stage_api::StageError;

use super::data::{Data, PORT, Panel, Strand, is_pseudo};
use super::params::FigureParams;
use crate::inference::Estimate;
use crate::reference::Reference;

/// A mark of an interval figure.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct Entry {
    /// The values of the categories' labels.
    pub(crate) category: Vec<String>,
    /// The number of its series.
    pub(crate) series: usize,
    pub(crate) estimate: Estimate,
    /// The means of the trainings, where there are too few for an interval.
    pub(crate) means: Vec<f64>,
    /// What was published.
    pub(crate) published: Option<f64>,
}

/// The labels that tell categories apart: those that are asked for, or all that vary and have no other place.
pub(crate) fn categories(params: &FigureParams, data: &Data) -> Vec<String> {
    if !params.categories.is_empty() {
        return params.categories.clone();
    }
    let taken = [&params.rows, &params.columns, &data.colour, &params.pool];
    let all: Vec<&Strand> = strands(data).collect();
    let vary = varying(&all).into_iter().filter(|(name, _)| {
        // A measure is one column, or the several that it names.
        name != "column" && taken.iter().all(|list| !list.contains(name))
    });
    vary.map(|(name, _)| name).collect()
}

/// The labels in which strands differ, with their values in the order of the strands; an absent label is `None`.
fn varying(strands: &[&Strand]) -> Vec<(String, Vec<Option<String>>)> {
    let names = unique(strands.iter().flat_map(|strand| strand.labels.keys()));
    let values = |name: &String| unique(strands.iter().map(|strand| strand.labels.get(name).cloned()));
    let all = names.into_iter().map(|name| (name.clone(), values(name)));
    all.filter(|(_, values)| values.len() > 1).collect()
}

/// Each item once, in the order in which they first appear.
fn unique<T: PartialEq>(items: impl Iterator<Item = T>) -> Vec<T> {
    let mut all = Vec::new();
    for item in items {
        if !all.contains(&item) {
            all.push(item);
        }
    }
    all
}

fn strands(data: &Data) -> impl Iterator<Item = &Strand> {
    data.panels.iter().flat_map(|panel| &panel.series).flat_map(|series| &series.groups).flatten()
}

/// The entries of a panel, categories in the order of the matrix.
///
/// # Errors
/// Files of one entry differ in a label outside `pool`, the reference file is none, or values are too large to average.
pub(crate) fn entries(
    params: &FigureParams,
    data: &Data,
    panel: &Panel,
    reference: Option<&Path>,
) -> Result<Vec<Entry>, StageError> {
    let names = categories(params, data);
    let keys: Vec<&String> =
        params.rows.iter().chain(&params.columns).chain(&data.colour).chain(&names).collect();
    let keys: Vec<&str> = keys.into_iter().map(String::as_str).filter(|key| !is_pseudo(key)).collect();
    let reference = reference.map(|path| Reference::read(path, &keys)).transpose()?;
    let mut entries: Vec<(Vec<String>, usize, Vec<&Strand>)> = Vec::new();
    for series in &panel.series {
        for strand in series.groups.iter().flatten() {
            let category = values(strand, names.iter().map(String::as_str));
            match entries.iter_mut().find(|(other, number, _)| *other == category && *number == series.number)
            {
                Some((_, _, strands)) => strands.push(strand),
                None => entries.push((category, series.number, vec![strand])),
            }
        }
    }
    let members: Vec<&[&Strand]> = entries.iter().map(|(_, _, strands)| strands.as_slice()).collect();
    only_trainings(params, &keys, &members)?;
    let entry = |(category, series, strands): (Vec<String>, usize, Vec<&Strand>)| {
        let trainings: Vec<&[f64]> = strands.iter().map(|strand| strand.y.as_slice()).collect();
        let estimate = Estimate::of(&trainings)
            .ok_or_else(|| StageError::failed("the values of input `data` are too large to average"))?;
        let means = trainings.iter().filter_map(|training| crate::inference::mean(training)).collect();
        let row = reference.as_ref().and_then(|file| file.get(&values(strands[0], keys.iter().copied())));
        let published = row.and_then(|row| row.mean.as_ref()).map(|mean| mean.value);
        Ok(Entry { category, series, estimate, means, published })
    };
    entries.into_iter().map(entry).collect()
}

/// Refuses entries whose files differ in labels outside `pool`: they are no trainings of one kind, and an interval over
/// them would have a unit that nobody chose.
fn only_trainings(params: &FigureParams, keys: &[&str], entries: &[&[&Strand]]) -> Result<(), StageError> {
    let mut seen: Vec<(String, Vec<String>)> = Vec::new();
    let mut first = None;
    for strands in entries {
        for (label, values) in varying(strands).into_iter().filter(|(label, _)| !params.pool.contains(label))
        {
            first = first.or(strands.first().copied());
            let values = values.into_iter().map(|value| value.unwrap_or_else(|| "absent".to_owned()));
            match seen.iter_mut().find(|(other, _)| *other == label) {
                Some((_, all)) => *all = unique(all.drain(..).chain(values)),
                None => seen.push((label, values.collect())),
            }
        }
    }
    let Some(first) = first else { return Ok(()) };
    let at = keys.iter().filter_map(|key| Some(format!("{key}={}", first.labels.get(*key)?)));
    let at = match at.collect::<Vec<_>>().join(", ") {
        at if at.is_empty() => String::new(),
        at => format!(" with {at}"),
    };
    let seen: Vec<String> =
        seen.iter().map(|(label, values)| format!("`{label}` ({})", values.join(", "))).collect();
    let (seen, which) = (seen.join(" and "), if seen.len() == 1 { "which is" } else { "which are" });
    Err(StageError::failed(format!(
        "files of input `{PORT}`{at} share one interval, but differ in {seen}, {which} not in `pool`; expected \
         trainings of one kind: add a label to `pool` if its values are trainings, else to `categories`, `colour`, \
         `rows` or `columns`, or connect one of its values only"
    )))
}

fn values<'n>(strand: &Strand, names: impl Iterator<Item = &'n str>) -> Vec<String> {
    names.map(|name| strand.labels.get(name).cloned().unwrap_or_default()).collect()
}

/// The categories of all entries, each once, in the order of the matrix: sorted by the labels in turn.
pub(crate) fn in_order(panels: &[Vec<Entry>]) -> Vec<Vec<String>> {
    let mut all: Vec<Vec<String>> = Vec::new();
    for entry in panels.iter().flatten() {
        if !all.contains(&entry.category) {
            all.push(entry.category.clone());
        }
    }
    crate::pivot::sort_by_appearance(&mut all, Vec::as_slice);
    all
}
