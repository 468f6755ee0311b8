//! The texts of a figure: axis titles, notes on its layers, and a description for screen readers.

use super::chart::Chart;
use super::data::Strand;
use super::layer::{self, Shape};
use super::outside;
use super::paint::MOST_POINTS;
use super::params::{BandOf, Measure};
use crate::caption;
use crate::inference::Over;

/// The titles of the axes.
pub(crate) fn titles(chart: &Chart<'_>) -> (String, String) {
    let params = chart.params;
    let measures = params.y.iter().map(Measure::title).collect::<Vec<_>>().join(", ");
    // Where measures have panels of their own, their headings name them.
    let has_panels = params.rows.iter().chain(&params.columns).any(|key| key == "measure");
    let measures = if has_panels { String::new() } else { measures };
    let (x, y) = if params.layers.interval.is_some() {
        (measures, String::new())
    } else if params.layers.histogram.is_some() {
        (measures, "count".to_owned())
    } else if params.layers.ecdf.is_some() {
        (measures, "share".to_owned())
    } else {
        (params.x.clone().unwrap_or_else(|| "row".to_owned()), measures)
    };
    let or = |given: &str, own: String| if given.is_empty() { own } else { given.to_owned() };
    (or(&params.x_title, x), or(&params.y_title, y))
}

/// The lines under the figure.
pub(crate) fn notes(chart: &Chart<'_>) -> Vec<String> {
    let params = chart.params;
    let mut layers = Vec::new();
    if params.layers.points.is_some() {
        layers.push(points(chart));
        layers.extend(outside::notes(chart));
    }
    if let Some(line) = &params.layers.line {
        let over = pooled(chart, 1).map(|over| format!("mean over {over}"));
        let window = (line.smooth > 1).then(|| format!("mean of the last {} rows", line.smooth));
        let what: Vec<String> = over.into_iter().chain(window).collect();
        if !what.is_empty() {
            layers.push(format!("line: {}", what.join(", ")));
        }
    }
    if let Some(band) = &params.layers.band
        && chart.contents.iter().flat_map(|content| &content.shapes).any(|drawn| drawn.layer == "band")
    {
        let of = match band.of {
            BandOf::MinMax => "lowest to highest value",
            BandOf::Quantiles => "10 % to 90 % quantile",
            BandOf::Interval => "95 % interval of the mean (t)",
        };
        let over = if band.window > 1 {
            let of = pooled(chart, 1).map_or_else(String::new, |pooled| format!(" of {pooled}"));
            format!("of the last {} rows{of}", band.window)
        } else {
            // It is drawn where there are at least two values.
            format!("over {}", pooled(chart, 2).unwrap_or_else(|| "rows with equal values of x".to_owned()))
        };
        layers.push(format!("band: {of} {over}"));
    }
    if params.layers.mean.is_some() {
        layers.push("dashed line: mean".to_owned());
    }
    if params.layers.interval.is_some() {
        layers.extend(intervals(chart));
    }
    if params.layers.points.is_none() {
        layers.extend(outside::notes(chart));
    }
    let mut notes = Vec::new();
    if !layers.is_empty() {
        let text = layers.join("; ");
        let mut letters = text.chars();
        notes.extend(letters.next().map(|first| format!("{}{}.", first.to_uppercase(), letters.as_str())));
    }
    notes.extend(panels(&params.rows, &params.columns));
    if !params.profile.is_empty()
        && let Some(full) = caption::reduced_from(&params.profile, params.full_profile.as_deref())
    {
        notes.push(format!(
            "Profile {}: sizes are reduced, so values are not those of profile {full}.",
            params.profile
        ));
    }
    if !params.note.trim().is_empty() {
        notes.push(crate::markdown::one_line(&params.note));
    }
    notes
}

/// The labels of the panels. Headings of measures and of named inputs explain themselves.
fn panels(rows: &[String], columns: &[String]) -> Option<String> {
    let labels = |all: &[String]| {
        let named = all.iter().map(String::as_str).filter(|label| !["measure", "name"].contains(label));
        named.collect::<Vec<_>>().join(" · ")
    };
    let (down, across) = (labels(rows), labels(columns));
    match (down.is_empty(), across.is_empty()) {
        (true, true) => None,
        (true, false) => Some(format!("Panels: {across}.")),
        (false, true) => Some(format!("Rows: {down}.")),
        (false, false) => Some(format!("Rows: {down}; columns: {across}.")),
    }
}

fn points(chart: &Chart<'_>) -> String {
    let shapes = chart.contents.iter().flat_map(|content| &content.shapes);
    let most = shapes.filter_map(|drawn| match &drawn.shape {
        Shape::Points(points) => Some(points.len()),
        _ => None,
    });
    match most.max() {
        Some(count) if count > MOST_POINTS => {
            format!("marks: single rows, thinned to {MOST_POINTS} a series (the CSV has all {count})")
        }
        _ => "marks: single rows".to_owned(),
    }
}

/// What is aggregated, as `5 values of seed`, or `3 to 5 values of seed` where not all have the same rows; `None` if
/// nothing is. Places with fewer than `least` values do not count.
fn pooled(chart: &Chart<'_>, least: usize) -> Option<String> {
    let groups = || {
        let series = chart.data.panels.iter().flat_map(|panel| &panel.series);
        series.flat_map(|series| series.groups.iter().map(Vec::as_slice))
    };
    groups().find(|group: &&[Strand]| group.len() > 1)?;
    let counts: Vec<usize> = groups().flat_map(layer::counts).filter(|count| *count >= least).collect();
    let (low, high) = (counts.iter().min()?, counts.iter().max()?);
    let pool = chart.params.pool.join(" and ");
    Some(match (low, high) {
        (_, 1) => {
            let x = chart.params.x.as_deref().unwrap_or("row");
            format!("1 value of {pool}, as no two share a {x}")
        }
        (low, high) if low == high => format!("{high} values of {pool}"),
        (low, high) => format!("{low} to {high} values of {pool}"),
    })
}

/// What the intervals are, for each way in which this figure has them.
fn intervals(chart: &Chart<'_>) -> Vec<String> {
    let entries = || chart.contents.iter().flat_map(|content| &content.entries);
    let mut texts = Vec::new();
    let range = |numbers: Vec<usize>| match (numbers.iter().min(), numbers.iter().max()) {
        (Some(low), Some(high)) if low == high => Some(low.to_string()),
        (Some(low), Some(high)) => Some(format!("{low} to {high}")),
        _ => None,
    };
    let with = |over: Over, has_interval: bool| {
        let chosen = entries().map(|entry| &entry.estimate);
        chosen
            .filter(|e| e.over == over && e.half_width.is_some() == has_interval)
            .copied()
            .collect::<Vec<_>>()
    };
    if let Some(n) = range(with(Over::Trainings, true).iter().map(|e| e.trainings).collect()) {
        texts.push(format!("bar: 95 % interval of the mean over {n} trainings (t)"));
    }
    if let Some(n) = range(with(Over::Episodes, true).iter().map(|e| e.episodes).collect()) {
        texts.push(format!(
            "bar: 95 % interval over {n} episodes of one training (this policy on other tracks, not other trainings)"
        ));
    }
    if let Some(n) = range(with(Over::Episodes, false).iter().map(|e| e.episodes).collect()) {
        texts.push(format!("no interval: {n} episodes of one training are too few"));
    }
    if !with(Over::Trainings, false).is_empty() {
        texts.push("small marks: two trainings, too few for an interval".to_owned());
    }
    if entries().any(|entry| entry.published.is_some()) {
        texts.push("hollow diamond: published value".to_owned());
    }
    texts
}

/// The description for screen readers.
pub(crate) fn description(chart: &Chart<'_>, x: &str, y: &str, notes: &[String]) -> String {
    let (panels, series) = (chart.data.panels.len(), chart.data.series.len());
    let count = |n: usize, what: &str| if n == 1 { String::new() } else { format!(", {n} {what}") };
    let axes = match (x, y) {
        ("", "") => "Values".to_owned(),
        (x, "") => format!("Values of {x}"),
        ("", y) => format!("Values of {y}"),
        (x, y) => format!("{y} over {x}"),
    };
    let names: Vec<String> =
        chart.data.series.iter().map(|key| key.join(" · ")).filter(|n| !n.is_empty()).collect();
    let names = if names.len() > 1 { format!(" ({})", names.join(", ")) } else { String::new() };
    let notes = notes.iter().map(|note| format!(" {note}")).collect::<String>();
    format!("{axes}{}{}{names}.{notes}", count(panels, "panels"), count(series, "series"))
}
