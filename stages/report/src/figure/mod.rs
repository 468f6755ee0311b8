//! The kind `figure`: draws CSV files of any stage as SVG, and writes the drawn values as CSV.
//!
//! | module | what it does |
//! |---|---|
//! | `params` | parameters |
//! | `data` | files and labels → panels, series, strands |
//! | `layer`, `intervals` | strands → shapes, in the units of the data |
//! | `ticks`, `layout` | axes, places on the canvas |
//! | `explain`, `outside` | texts |
//! | `chart`, `draw`, `paint`, `clip` | shapes → plotters |
//! | `svg`, `ink` | plotters → SVG |
//! | `drawn` | shapes → CSV |

mod chart;
mod clip;
mod data;
mod draw;
mod drawn;
mod explain;
mod ink;
mod intervals;
mod layer;
mod layout;
mod outside;
mod paint;
mod params;
mod svg;
mod ticks;

use std::path::Path;

use dril_stage_api::{Artifact, Ctx, Describe, FanIns, InputItem, Ports, Problems, Stage, StageError};

use crate::reference;
pub use params::{
    Area, Band, BandOf, Ecdf, FigureParams, Histogram, Intervals, Layers, Line, Mark, Mean, Measure, Points,
    Preset, Ranges, Rule, Scales, Span,
};
pub(crate) use svg::escape;
pub use ticks::Scale;

/// Draws CSV files.
///
/// Inputs: `data`, any number of CSV files with a header, each with its labels; `reference`, if given, a CSV file with
/// the labels and `mean` as columns, for the published values of intervals.
///
/// Outputs: `svg`, and `csv` with the columns `<labels>,layer,strand,x,y,low,high,n`.
///
/// Equal inputs, labels and parameters give equal bytes; series, colours and panels follow the order of the matrix.
pub struct Figure;

impl Describe for Figure {
    const KIND: &'static str = "figure";
    const REVISION: u32 = 4;
    const ABOUT: &'static str = "draws CSV files as SVG, with panels, colours and lines by their labels";
    const SEEDED: bool = false;
    type Params = FigureParams;

    fn check(params: &FigureParams, problems: &mut Problems) {
        params.check(problems);
    }

    fn check_labels(params: &FigureParams, inputs: &FanIns<'_>, problems: &mut Problems) {
        crate::samples::check_unique(data::PORT, inputs, problems);
        let full = params.filled();
        data::check_labels(&full, inputs, problems);
        data::check_columns(&full, inputs, problems);
    }

    fn ports(_: &FigureParams) -> Ports {
        Ports::new()
            .many(
                data::PORT,
                Artifact::FILE,
                "CSV files with a header; their labels select panel, colour and line",
            )
            .optional(
                reference::PORT,
                Artifact::FILE,
                "published values: a CSV file with the labels and `mean`",
            )
            .output("svg", Artifact::FIGURE, "svg", "the figure")
            .output("csv", Artifact::TABLE, "csv", "the drawn values, one row per marker")
    }
}

impl Stage for Figure {
    type Kind = Self;

    fn run(params: &FigureParams, ctx: &mut Ctx<'_>) -> Result<(), StageError> {
        ctx.stop_if_cancelled()?;
        let drawing = draw(params, &ctx.inputs(data::PORT), ctx.optional_input(reference::PORT))?;
        ctx.write_output("svg", drawing.svg)?;
        ctx.write_output("csv", drawing.csv)
    }
}

/// A figure as SVG and as CSV.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Drawing {
    /// The SVG file.
    pub svg: String,
    /// The CSV file.
    pub csv: Vec<u8>,
}

/// Draws files that carry labels.
///
/// # Errors
/// A file is not CSV, or lacks a column or label that the parameters name.
pub fn draw(
    params: &FigureParams,
    items: &[InputItem<'_>],
    reference: Option<&Path>,
) -> Result<Drawing, StageError> {
    if items.is_empty() {
        return Err(StageError::Port("input `data` is not connected, expected at least one file".to_owned()));
    }
    crate::samples::unique(data::PORT, items)?;
    let params = params.filled();
    let data = data::arrange(&params, data::read(&params, items)?)?;
    let chart = chart::Chart::new(&params, &data, reference)?;
    Ok(Drawing { svg: chart.svg()?, csv: drawn::csv(&chart).map_err(StageError::failed)? })
}
