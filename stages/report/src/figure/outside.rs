//! What a figure omits or cuts at its axes, as notes under it: nothing is left out in silence.

use super::chart::Chart;
use super::intervals::Entry;
use super::layer::{Drawn, Shape};
use super::ticks::Scale;

/// The layers that show rows; the first that a figure has is counted.
const LAYERS: [(&str, [&str; 2]); 5] = [
    ("points", ["row", "rows"]),
    ("line", ["point of the lines", "points of the lines"]),
    ("ecdf", ["point of the lines", "points of the lines"]),
    ("area", ["point of the areas", "points of the areas"]),
    ("band", ["point of the bands", "points of the bands"]),
];

/// One axis, as far as it may omit values.
#[derive(Clone, Copy)]
struct Limits {
    range: Option<[f64; 2]>,
    scale: Scale,
}

impl Limits {
    fn omits(self, value: f64) -> bool {
        self.scale.place(value).is_none()
    }

    fn excludes(self, value: f64) -> bool {
        self.range.is_some_and(|[low, high]| value < low || value > high)
    }
}

/// The notes.
pub(crate) fn notes(chart: &Chart<'_>) -> Vec<String> {
    let params = chart.params;
    let x = Limits { range: params.range.x, scale: params.scale.x };
    let y = Limits { range: params.range.y, scale: params.scale.y };
    let shapes = || chart.contents.iter().flat_map(|content| &content.shapes);
    let mut notes = Vec::new();
    if let Some((layer, what)) = LAYERS.iter().find(|(layer, _)| shapes().any(|drawn| drawn.layer == *layer))
    {
        let points: Vec<[f64; 3]> =
            shapes().filter(|drawn| drawn.layer == *layer).flat_map(|drawn| places(&drawn.shape)).collect();
        let (gone, shown): (Vec<[f64; 3]>, Vec<_>) =
            points.into_iter().partition(|[at, low, high]| x.omits(*at) || y.omits(*low) && y.omits(*high));
        let far = |[at, low, high]: &&[f64; 3]| x.excludes(*at) || y.excludes(*low) || y.excludes(*high);
        notes.extend(omitted(gone.len(), *what));
        notes.extend(lie_outside(shown.iter().filter(far).count(), *what));
    }
    if params.layers.histogram.is_some() {
        let strands = chart.data.panels.iter().flat_map(|panel| &panel.series).flat_map(|one| &one.groups);
        let values = strands.flatten().flat_map(|strand| &strand.y);
        notes.extend(lie_outside(values.filter(|value| x.excludes(**value)).count(), ["value", "values"]));
    }
    let mut means: Vec<f64> = Vec::new();
    let entries: Vec<&Entry> = chart.contents.iter().flat_map(|content| &content.entries).collect();
    for entry in &entries {
        match entry.estimate.half_width {
            None if entry.means.len() > 1 => means.extend(&entry.means),
            _ => means.push(entry.estimate.mean),
        }
    }
    let (gone, means): (Vec<f64>, Vec<f64>) = means.into_iter().partition(|mean| x.omits(*mean));
    notes.extend(omitted(gone.len(), ["mean", "means"]));
    let far = means.into_iter().filter(|mean| x.excludes(*mean)).count();
    notes.extend(lie_outside(
        far + shapes().filter(|drawn| is_level_outside(drawn, x, y)).count(),
        ["mean", "means"],
    ));
    let published = entries.iter().filter_map(|entry| entry.published);
    let far = published.filter(|value| x.excludes(*value)).count();
    notes.extend(lie_outside(far, ["published value", "published values"]));
    let far = shapes().filter(|drawn| matches!(drawn.shape, Shape::Mark(value) if x.excludes(value))).count();
    notes.extend(lie_outside(far, ["marked value", "marked values"]));
    notes.extend(match cut_bars(chart, x, y) {
        0 => None,
        1 => Some("1 bar reaches beyond the axes".to_owned()),
        bars => Some(format!("{bars} bars reach beyond the axes")),
    });
    notes
}

fn lie_outside(count: usize, [one, many]: [&str; 2]) -> Option<String> {
    match count {
        0 => None,
        1 => Some(format!("1 {one} lies outside the axes")),
        count => Some(format!("{count} {many} lie outside the axes")),
    }
}

fn omitted(count: usize, [one, many]: [&str; 2]) -> Option<String> {
    match count {
        0 => None,
        1 => Some(format!("1 {one} at or below 0 is omitted")),
        count => Some(format!("{count} {many} at or below 0 are omitted")),
    }
}

/// The points of a shape: the place along x, and the lowest and highest value there.
fn places(shape: &Shape) -> Vec<[f64; 3]> {
    match shape {
        Shape::Points(points) | Shape::Line(points) | Shape::Steps(points) | Shape::Area(points) => {
            points.iter().map(|(x, y)| [*x, *y, *y]).collect()
        }
        Shape::Band(edges) => edges.iter().map(|(x, low, high)| [*x, *low, *high]).collect(),
        Shape::Bars(_) | Shape::Level(..) | Shape::Mark(_) => Vec::new(),
    }
}

/// True for a mean that no part of the plot shows.
fn is_level_outside(drawn: &Drawn, x: Limits, y: Limits) -> bool {
    let Shape::Level(from, to, mean) = drawn.shape else { return false };
    y.excludes(mean) || x.range.is_some_and(|[low, high]| to < low || from > high)
}

/// How many bars of histograms and of intervals do not end inside.
fn cut_bars(chart: &Chart<'_>, x: Limits, y: Limits) -> usize {
    let is_cut = |content: &super::chart::Content| {
        let bars = content.shapes.iter().filter_map(|drawn| match &drawn.shape {
            Shape::Bars(bars) => Some(bars),
            _ => None,
        });
        let bars = bars.flatten().filter(|(_, _, height)| *height > 0.0 && y.excludes(*height)).count();
        let ends = content.entries.iter().filter_map(|entry| {
            let (mean, half) = (entry.estimate.mean, entry.estimate.half_width?);
            Some([mean - half, mean + half])
        });
        bars + ends.filter(|ends| ends.iter().any(|end| x.excludes(*end))).count()
    };
    chart.contents.iter().map(is_cut).sum()
}
