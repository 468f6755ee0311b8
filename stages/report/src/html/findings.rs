//! Findings: each claim with its verdict and interval.

use dril_stage_api::StageError;
use dril_stage_api::outcome::PipelineOutcome;
use maud::{Markup, html};

use super::csvs::Csv;
use super::grid::{DIVERGED, decimals};
use super::{Section, link, made, read, title_of};
use crate::number::fixed;

/// The width and the height of a bar in pixels.
const BAR: (f64, f64) = (180.0, 22.0);

/// The findings of all stages of the kind, one after the other.
pub(crate) fn section(outcome: &PipelineOutcome) -> Result<Option<Section>, StageError> {
    let all = made(outcome, |stage, output| stage.kind == "findings" && output.name == "csv");
    let mut bodies: Vec<Markup> = Vec::new();
    for (stage, output) in all {
        let Some(csv) = Csv::parse(&read(output)?) else { continue };
        bodies.push(html! { (table(&csv, &title_of(stage), decimals(&stage.params))) p class="quiet" { (link(output)) } });
    }
    let body = html! { @for body in &bodies { (body) } };
    Ok((!bodies.is_empty()).then_some(Section { anchor: "findings", title: "Findings", body }))
}

/// How many claims hold, are contradicted, are undecided; `None` where there are no findings.
pub(crate) fn counts(outcome: &PipelineOutcome) -> Result<Option<[(&'static str, usize); 3]>, StageError> {
    let mut counts = [("holds", 0), ("contradicted", 0), ("undecided", 0)];
    for (_, output) in made(outcome, |stage, output| stage.kind == "findings" && output.name == "csv") {
        let Some(csv) = Csv::parse(&read(output)?) else { continue };
        for row in &csv.rows {
            counts
                .iter_mut()
                .filter(|(name, _)| *name == csv.cell(row, "verdict"))
                .for_each(|(_, n)| *n += 1);
        }
    }
    Ok(counts.iter().any(|(_, n)| *n > 0).then_some(counts))
}

/// True if findings rest on one training per cell.
pub(crate) fn rest_on_one_training(outcome: &PipelineOutcome) -> Result<bool, StageError> {
    for (_, output) in made(outcome, |stage, output| stage.kind == "findings" && output.name == "csv") {
        let csv = Csv::parse(&read(output)?).unwrap_or_default();
        if csv.rows.iter().any(|row| csv.cell(row, "over") == "tracks") {
            return Ok(true);
        }
    }
    Ok(false)
}

fn table(csv: &Csv, caption: &str, decimals: usize) -> Markup {
    let number = |row: &[String], name: &str| csv.cell(row, name).parse::<f64>().ok();
    let all = csv.rows.iter().flat_map(|row| ["low", "high", "difference"].map(|name| number(row, name)));
    // A unit of the last place, so that differences of about 0 stay in the middle.
    let smallest = 10f64.powi(-(decimals as i32));
    let reach = all.flatten().map(f64::abs).fold(smallest, f64::max);
    let has_reference = csv.rows.iter().any(|row| number(row, "reference").is_some());
    let diverged = |row: &[String]| number(row, "diverged").is_some_and(|count| count > 0.0);
    html! {
        div class="wide" tabindex="0" role="region" aria-label=(caption) {
            table {
                caption { (caption) }
                thead { tr {
                    th scope="col" { "claim" } th scope="col" { "verdict" }
                    th scope="col" { "difference, 95 % interval" }
                    @if has_reference { th scope="col" class="n" { "reported" } }
                    th scope="col" class="n" { "p (Holm)" } th scope="col" class="n" { "positive pairs" }
                } }
                tbody { @for row in &csv.rows { tr {
                    td class="claim" {
                        (csv.cell(row, "claim")) @if diverged(row) { (DIVERGED) }
                        br; small { (csv.cell(row, "is")) }
                    }
                    td { span class=(csv.cell(row, "verdict")) { (csv.cell(row, "verdict")) } }
                    td { (bar(reach, ["difference", "low", "high"].map(|name| number(row, name)), decimals)) }
                    @if has_reference {
                        td class="n" { (around(number(row, "reference"), number(row, "reference_high"), decimals)) }
                    }
                    td class="n" { (if csv.cell(row, "p") == "0.0000" { "< 0.0001" } else { csv.cell(row, "p") }) }
                    td class="n" { (csv.cell(row, "positive")) " of " (csv.cell(row, "pairs")) }
                } } }
            }
        }
        @if csv.rows.iter().any(|row| diverged(row)) {
            p class="quiet" {
                (DIVERGED) ": on one of the sides training diverged, and the last finite weights were evaluated."
            }
        }
    }
}

/// `12 ± 3`; without an upper end only the mean.
fn around(mean: Option<f64>, high: Option<f64>, decimals: usize) -> String {
    let number = |value: f64| fixed(value, decimals);
    let text = match (mean, high) {
        (Some(mean), Some(high)) => format!("{} ± {}", number(mean), number(high - mean)),
        (Some(mean), None) => number(mean),
        _ => String::new(),
    };
    text.replace('-', "−")
}

/// The number, and its interval on a scale that all claims share, with 0 in the middle.
fn bar(reach: f64, [mean, low, high]: [Option<f64>; 3], decimals: usize) -> Markup {
    let (width, height) = BAR;
    let at = |value: f64| format!("{:.1}", width / 2.0 + value / reach * (width / 2.0 - 6.0));
    let middle = format!("{:.1}", height / 2.0);
    let Some(mean) = mean else { return html! { span class="quiet" { "too few values" } } };
    html! {
        span class="n" { (around(Some(mean), high, decimals)) }
        svg viewBox=(format!("0 0 {width} {height}")) width=(width) height=(height) aria-hidden="true" color="currentColor" style="display:block" {
            line x1=(at(0.0)) x2=(at(0.0)) y1="1" y2="21" stroke="currentColor" stroke-opacity="0.5" stroke-dasharray="2 2" {}
            @if let (Some(low), Some(high)) = (low, high) {
                line x1=(at(low)) x2=(at(high)) y1=(middle) y2=(middle) stroke="currentColor" stroke-width="2" {}
            }
            circle cx=(at(mean)) cy=(middle) r="3.5" fill="currentColor" {}
        }
    }
}
