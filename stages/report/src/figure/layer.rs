//! From series to shapes: what each layer draws, in the units of the data.

use super::data::{Data, Panel, Series, Strand};
use super::params::{BandOf, FigureParams};
use crate::inference;
use crate::stats::Summary;

/// Something to draw.
#[derive(Clone, Debug, PartialEq)]
pub(crate) enum Shape {
    /// Marks.
    Points(Vec<(f64, f64)>),
    /// A line.
    Line(Vec<(f64, f64)>),
    /// A step function; steps run along the horizontal axis first.
    Steps(Vec<(f64, f64)>),
    /// From the lower to the upper value at each place.
    Band(Vec<(f64, f64, f64)>),
    /// From 0 to the value at each place.
    Area(Vec<(f64, f64)>),
    /// Bars from one value to the next, of these heights.
    Bars(Vec<(f64, f64, f64)>),
    /// A dashed horizontal line from one place to another.
    Level(f64, f64, f64),
    /// A vertical line, named by its strand.
    Mark(f64),
}

/// A shape with what it is.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct Drawn {
    pub(crate) layer: &'static str,
    /// The number of its series.
    pub(crate) series: usize,
    /// Its name within the series.
    pub(crate) strand: String,
    pub(crate) shape: Shape,
}

/// The shapes of a panel, in the order in which they are drawn.
pub(crate) fn shapes(params: &FigureParams, panel: &Panel, bounds: (f64, f64)) -> Vec<Drawn> {
    let layers = &params.layers;
    let mut drawn = Vec::new();
    let mut add = |layer, series: &Series, strand: String, shape| {
        drawn.push(Drawn { layer, series: series.number, strand, shape });
    };
    for series in &panel.series {
        let groups = || series.groups.iter().map(|group| (name_of(series, group), group));
        if layers.area.is_some() {
            groups().for_each(|(name, group)| add("area", series, name, Shape::Area(joined(group, 1))));
        }
        if let Some(band) = &layers.band {
            for (name, group) in groups() {
                let found = if band.window > 1 {
                    rolling(group, band.window, band.of)
                } else {
                    across(group, band.of)
                };
                if !found.is_empty() {
                    add("band", series, name, Shape::Band(found));
                }
            }
        }
        if let Some(histogram) = &layers.histogram {
            add("histogram", series, String::new(), Shape::Bars(bars(series, bounds, histogram.bins)));
        }
    }
    for series in &panel.series {
        let groups = || series.groups.iter().map(|group| (name_of(series, group), group));
        if layers.points.is_some() {
            let all = series.groups.iter().flatten();
            let all = all.flat_map(|strand| strand.x.iter().copied().zip(strand.y.iter().copied()));
            add("points", series, String::new(), Shape::Points(all.collect()));
        }
        if let Some(line) = &layers.line {
            for (name, group) in groups() {
                add("line", series, name, Shape::Line(joined(group, line.smooth)));
            }
        }
        if layers.mean.is_some() {
            for (name, group) in groups() {
                add_mean(&mut add, series, name, group);
            }
        }
        if layers.ecdf.is_some() {
            add("ecdf", series, String::new(), Shape::Steps(shares(series)));
        }
    }
    let mut marks: Vec<&(String, f64)> = Vec::new();
    for series in &panel.series {
        for mark in series.groups.iter().flatten().filter_map(|strand| strand.mark.as_ref()) {
            if !marks.contains(&mark) {
                marks.push(mark);
                add("mark", series, mark.0.clone(), Shape::Mark(mark.1));
            }
        }
    }
    drawn
}

fn add_mean(
    add: &mut impl FnMut(&'static str, &Series, String, Shape),
    series: &Series,
    name: String,
    group: &[Strand],
) {
    let values: Vec<f64> = group.iter().flat_map(|strand| strand.y.iter().copied()).collect();
    let places = || group.iter().flat_map(|strand| strand.x.iter().copied());
    if let (Some(summary), Some(from), Some(to)) =
        (Summary::of(&values), places().reduce(f64::min), places().reduce(f64::max))
    {
        add("mean", series, name, Shape::Level(from, to, summary.mean));
    }
}

/// What tells a group from the other groups of its series: the values of the labels in which they differ.
fn name_of(series: &Series, group: &[Strand]) -> String {
    let Some(first) = group.first() else { return String::new() };
    let differs = |name: &String, value: &String| {
        series.groups.iter().flatten().any(|other| other.labels.get(name) != Some(value))
    };
    let named = first.labels.iter().filter(|(name, value)| {
        differs(name, value) && group.iter().all(|strand| strand.labels.get(*name) == Some(value))
    });
    named.map(|(name, value)| format!("{name}={value}")).collect::<Vec<_>>().join(", ")
}

/// The values of a group at each place: several strands at equal places are taken together.
fn columns(group: &[Strand]) -> Vec<(f64, Vec<f64>)> {
    let mut all: Vec<(f64, f64)> =
        group.iter().flat_map(|strand| strand.x.iter().copied().zip(strand.y.iter().copied())).collect();
    // Stable, so that equal places keep the order of the matrix.
    all.sort_by(|a, b| a.0.total_cmp(&b.0));
    let mut columns: Vec<(f64, Vec<f64>)> = Vec::new();
    for (x, y) in all {
        match columns.last_mut() {
            Some((at, values)) if *at == x => values.push(y),
            _ => columns.push((x, vec![y])),
        }
    }
    columns
}

/// The line of a group: its only strand, or the mean of its strands at each place; each point the mean of the last
/// `smooth` of these.
fn joined(group: &[Strand], smooth: usize) -> Vec<(f64, f64)> {
    let mut line: Vec<(f64, f64)> = match group {
        [one] => one.x.iter().copied().zip(one.y.iter().copied()).collect(),
        more => {
            let mean = |(x, values): (f64, Vec<f64>)| Some((x, inference::mean(&values)?));
            columns(more).into_iter().filter_map(mean).collect()
        }
    };
    if smooth > 1 {
        let values: Vec<f64> = line.iter().map(|(_, y)| *y).collect();
        for (n, point) in line.iter_mut().enumerate() {
            let window = &values[(n + 1).saturating_sub(smooth)..=n];
            point.1 = window.iter().sum::<f64>() / window.len() as f64;
        }
    }
    line
}

/// The rows of a group: those of its only strand, or the values of its strands at each place.
fn rows_of(group: &[Strand]) -> Vec<(f64, Vec<f64>)> {
    match group {
        [one] => one.x.iter().zip(&one.y).map(|(x, y)| (*x, vec![*y])).collect(),
        more => columns(more),
    }
}

/// The band over the last rows of a group.
fn rolling(group: &[Strand], window: usize, of: BandOf) -> Vec<(f64, f64, f64)> {
    let rows = rows_of(group);
    let edges = |n: usize| {
        let values: Vec<f64> =
            rows[(n + 1).saturating_sub(window)..=n].iter().flat_map(|(_, values)| values).copied().collect();
        let (low, high) = reach(&values, of)?;
        Some((rows[n].0, low, high))
    };
    (0..rows.len()).filter_map(edges).collect()
}

/// How many strands of a group have a row, at each place in turn.
pub(crate) fn counts(group: &[Strand]) -> Vec<usize> {
    if group.len() == 1 {
        return vec![1];
    }
    let places = group.iter().enumerate().flat_map(|(n, strand)| strand.x.iter().map(move |x| (*x, n)));
    let mut places: Vec<(f64, usize)> = places.collect();
    places.sort_by(|a, b| a.0.total_cmp(&b.0).then(a.1.cmp(&b.1)));
    places.dedup();
    places.chunk_by(|a, b| a.0 == b.0).map(<[_]>::len).collect()
}

/// The band over the strands of a group, at the places that at least two of them have.
fn across(group: &[Strand], of: BandOf) -> Vec<(f64, f64, f64)> {
    let edges = |(x, values): (f64, Vec<f64>)| {
        let (low, high) = reach(&values, of)?;
        (values.len() > 1).then_some((x, low, high))
    };
    columns(group).into_iter().filter_map(edges).collect()
}

fn reach(values: &[f64], of: BandOf) -> Option<(f64, f64)> {
    match of {
        BandOf::MinMax => {
            Some((values.iter().copied().reduce(f64::min)?, values.iter().copied().reduce(f64::max)?))
        }
        BandOf::Quantiles => {
            let mut sorted = values.to_vec();
            sorted.sort_by(f64::total_cmp);
            Some((quantile(&sorted, 0.1)?, quantile(&sorted, 0.9)?))
        }
        BandOf::Interval => {
            let (mean, half) = (inference::mean(values)?, inference::half_width(values)?);
            Some((mean - half, mean + half))
        }
    }
}

/// The quantile of sorted values, linear between neighbours (type 7 of Hyndman and Fan, NumPy's).
pub(crate) fn quantile(sorted: &[f64], share: f64) -> Option<f64> {
    let place = share * sorted.len().checked_sub(1)? as f64;
    let below = place.floor() as usize;
    let (low, high) = (sorted.get(below)?, sorted.get(below + 1).or(sorted.get(below))?);
    Some(low + (high - low) * (place - below as f64))
}

fn values(series: &Series) -> Vec<f64> {
    series.groups.iter().flatten().flat_map(|strand| strand.y.iter().copied()).collect()
}

/// The counts of a series in equal parts of the range `bounds`, the last part with its upper end.
fn bars(series: &Series, (low, high): (f64, f64), bins: usize) -> Vec<(f64, f64, f64)> {
    let width = (high - low) / bins as f64;
    let mut counts = vec![0_u32; bins];
    for value in values(series).into_iter().filter(|value| (low..=high).contains(value)) {
        let bin = if width > 0.0 { ((value - low) / width) as usize } else { 0 };
        counts[bin.min(bins - 1)] += 1;
    }
    let edge = |n: usize| low + width * n as f64;
    counts.into_iter().enumerate().map(|(n, count)| (edge(n), edge(n + 1), f64::from(count))).collect()
}

/// The share of values that are at most each value.
fn shares(series: &Series) -> Vec<(f64, f64)> {
    let mut sorted = values(series);
    sorted.sort_by(f64::total_cmp);
    let count = sorted.len() as f64;
    let mut steps: Vec<(f64, f64)> = sorted.first().map(|first| (*first, 0.0)).into_iter().collect();
    for (n, value) in sorted.iter().enumerate() {
        let share = (n + 1) as f64 / count;
        match steps.last_mut() {
            Some((at, height)) if *at == *value && *height > 0.0 => *height = share,
            _ => steps.push((*value, share)),
        }
    }
    steps
}

/// The lowest and highest value of all measures, for histograms; widened where there is only one.
pub(crate) fn bounds(params: &FigureParams, data: &Data) -> (f64, f64) {
    if let Some([low, high]) = params.range.x {
        return (low, high);
    }
    let strands =
        data.panels.iter().flat_map(|panel| &panel.series).flat_map(|series| &series.groups).flatten();
    let (low, high) = strands
        .flat_map(|strand| &strand.y)
        .fold((f64::INFINITY, f64::NEG_INFINITY), |(low, high), value| (low.min(*value), high.max(*value)));
    if low < high { (low, high) } else { (low - 0.5, low + 0.5) }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn strand(values: &[(f64, f64)]) -> Strand {
        let (x, y) = values.iter().copied().unzip();
        Strand { labels: Default::default(), x, y, mark: None }
    }

    #[test]
    fn a_smoothed_line_is_the_mean_of_the_last_rows() {
        let group = [strand(&[(0.0, 1.0), (1.0, 3.0), (2.0, 8.0)])];
        assert_eq!(joined(&group, 2), [(0.0, 1.0), (1.0, 2.0), (2.0, 5.5)]);
        assert_eq!(joined(&group, 1), joined(&group, 0));
    }

    #[test]
    fn strands_are_taken_together_where_they_have_equal_places() {
        let group = [strand(&[(0.0, 1.0), (2.0, 5.0)]), strand(&[(0.0, 3.0), (1.0, 9.0), (2.0, 7.0)])];
        assert_eq!(joined(&group, 1), [(0.0, 2.0), (1.0, 9.0), (2.0, 6.0)]);
        assert_eq!(across(&group, BandOf::MinMax), [(0.0, 1.0, 3.0), (2.0, 5.0, 7.0)]);
    }

    #[test]
    fn quantiles_lie_between_neighbours() {
        let sorted: Vec<f64> = (0..11).map(f64::from).collect();
        assert_eq!(quantile(&sorted, 0.1), Some(1.0));
        assert_eq!(quantile(&sorted, 0.25), Some(2.5));
        assert_eq!(quantile(&[4.0], 0.9), Some(4.0));
        assert_eq!(quantile(&[], 0.9), None);
    }

    #[test]
    fn a_mark_is_drawn_once_however_many_series_have_it() {
        let mark = |value| Some(("expert".to_owned(), value));
        let series = |number, value| Series {
            key: Vec::new(),
            number,
            groups: vec![vec![Strand { mark: mark(value), ..strand(&[(0.0, 1.0), (1.0, 2.0)]) }]],
        };
        let panel = Panel {
            row: Vec::new(),
            column: Vec::new(),
            series: vec![series(0, 0.5), series(1, 0.5), series(2, 0.7)],
        };
        let params: FigureParams =
            serde_json::from_value(serde_json::json!({ "title": "t", "layers": { "ecdf": {} } })).unwrap();
        let shapes = shapes(&params, &panel, (0.0, 2.0));
        let marks = shapes.iter().filter_map(|drawn| match drawn.shape {
            Shape::Mark(value) => Some((drawn.strand.as_str(), value)),
            _ => None,
        });
        assert_eq!(marks.collect::<Vec<_>>(), [("expert", 0.5), ("expert", 0.7)]);
    }

    #[test]
    fn every_value_is_in_one_bar_and_the_shares_end_at_one() {
        let groups = vec![vec![strand(&[(0.0, 0.0), (1.0, 1.0), (2.0, 1.0), (3.0, 4.0)])]];
        let series = Series { key: Vec::new(), number: 0, groups };
        let bars = bars(&series, (0.0, 4.0), 4);
        assert_eq!(bars.iter().map(|bar| bar.2).collect::<Vec<_>>(), [1.0, 2.0, 0.0, 1.0]);
        assert_eq!(shares(&series), [(0.0, 0.0), (0.0, 0.25), (1.0, 0.75), (4.0, 1.0)]);
    }
}
