//! What a figure draws, as CSV: one line a mark, in the units of the data, nothing thinned.

use super::chart::Chart;
use super::intervals;
use super::layer::Shape;
use crate::number::fixed;

/// The columns after those of the labels.
const COLUMNS: [&str; 7] = ["layer", "strand", "x", "y", "low", "high", "n"];

/// The table.
///
/// # Errors
/// The writer's, which a table in memory does not have.
pub(crate) fn csv(chart: &Chart<'_>) -> Result<Vec<u8>, Box<dyn std::error::Error>> {
    let (params, data) = (chart.params, chart.data);
    let categories =
        if params.layers.interval.is_some() { intervals::categories(params, data) } else { Vec::new() };
    let mut writer = csv::Writer::from_writer(Vec::new());
    let labels = params.rows.iter().chain(&params.columns).chain(&data.colour).chain(&categories);
    writer.write_record(labels.map(String::as_str).chain(COLUMNS))?;
    for (panel, content) in data.panels.iter().zip(&chart.contents) {
        let mut line = |series: usize, category: &[String], cells: [String; 7]| {
            let series = data.series.get(series).map_or(&[][..], Vec::as_slice);
            let labels = panel.row.iter().chain(&panel.column).chain(series).chain(category);
            writer.write_record(labels.chain(&cells))
        };
        for drawn in &content.shapes {
            let cells = |x: Option<f64>, y: Option<f64>, low: Option<f64>, high: Option<f64>| {
                let number = |value: Option<f64>| value.map_or_else(String::new, |value| value.to_string());
                let (layer, strand) = (drawn.layer.to_owned(), drawn.strand.clone());
                [layer, strand, number(x), number(y), number(low), number(high), String::new()]
            };
            let rows: Vec<[String; 7]> = match &drawn.shape {
                Shape::Points(points) | Shape::Line(points) | Shape::Steps(points) | Shape::Area(points) => {
                    points.iter().map(|(x, y)| cells(Some(*x), Some(*y), None, None)).collect()
                }
                Shape::Band(edges) => edges
                    .iter()
                    .map(|(x, low, high)| cells(Some(*x), None, Some(*low), Some(*high)))
                    .collect(),
                Shape::Bars(bars) => {
                    bars.iter().map(|(from, to, n)| cells(None, Some(*n), Some(*from), Some(*to))).collect()
                }
                Shape::Level(_, _, y) => vec![cells(None, Some(*y), None, None)],
                Shape::Mark(value) => vec![cells(Some(*value), None, None, None)],
            };
            rows.into_iter().try_for_each(|cells| line(drawn.series, &[], cells))?;
        }
        for entry in &content.entries {
            let number = |value: Option<f64>| value.map_or_else(String::new, |value| fixed(value, 4));
            let (mean, half) = (entry.estimate.mean, entry.estimate.half_width);
            let (low, high) = (number(half.map(|half| mean - half)), number(half.map(|half| mean + half)));
            let n = entry.estimate.trainings.to_string();
            let empty = String::new;
            let cells = ["interval".to_owned(), empty(), number(Some(mean)), empty(), low, high, n];
            line(entry.series, &entry.category, cells)?;
            if entry.published.is_some() {
                let x = number(entry.published);
                let cells = ["published".to_owned(), empty(), x, empty(), empty(), empty(), empty()];
                line(entry.series, &entry.category, cells)?;
            }
        }
    }
    Ok(writer.into_inner()?)
}
