//! The layer `interval`: one line for each category, with mean, 95 % interval and published value.

use std::path::Path;

use dril_stage_api::StageError;

use super::data::{Data, Panel, Strand};
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
    let mut names: Vec<(String, Vec<&String>)> = Vec::new();
    for (name, value) in strands(data).flat_map(|strand| &strand.labels) {
        match names.iter_mut().find(|(other, _)| other == name) {
            Some((_, values)) if values.contains(&value) => {}
            Some((_, values)) => values.push(value),
            None => names.push((name.clone(), vec![value])),
        }
    }
    let vary = names.into_iter().filter(|(name, values)| {
        // A measure is one column, or the several that it names.
        name != "column" && values.len() > 1 && taken.iter().all(|list| !list.contains(name))
    });
    vary.map(|(name, _)| name).collect()
}

fn strands(data: &Data) -> impl Iterator<Item = &Strand> {
    data.panels.iter().flat_map(|panel| &panel.series).flat_map(|series| &series.groups).flatten()
}

/// The entries of a panel, categories in the order of the matrix.
///
/// # Errors
/// The reference file is none, or values are too large to average.
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

fn is_pseudo(label: &str) -> bool {
    label == "measure" || label == "column"
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
