//! The tables of the report: the largest first, the others folded.

use dril_stage_api::outcome::{InputOutcome, OutputOutcome, PipelineOutcome, StageOutcome, State};
use dril_stage_api::{Artifact, InputItem, Labels, StageError};
use maud::{Markup, html};

use super::csvs::Csv;
use super::{LARGEST_TABLE, Room, Section, count, grid, link, made, read, title_of, too_large};
use crate::{reference, samples};

/// Tables shown, at most; the rest are links.
const MOST_TABLES: usize = 40;

/// The tables, except those with sections of their own.
fn tables(outcome: &PipelineOutcome) -> Vec<(&StageOutcome, &OutputOutcome)> {
    made(outcome, |stage, output| {
        let has_its_own_section = ["findings", "figure"].contains(&stage.kind.as_str());
        output.artifact == Artifact::TABLE && output.extension == "csv" && !has_its_own_section
    })
}

/// The table with the most rows of the kind `table`, or else the largest table: it mostly holds all the others.
fn first_of<'o>(
    tables: &[(&'o StageOutcome, &'o OutputOutcome)],
) -> Result<Option<(&'o StageOutcome, &'o OutputOutcome, Csv)>, StageError> {
    let mut best: Option<(bool, usize, &StageOutcome, &OutputOutcome, Csv)> = None;
    for (stage, output) in tables {
        let Some(csv) = Csv::parse(&read(output)?) else { continue };
        let rank = (stage.kind == "table", csv.rows.len());
        if best.as_ref().is_none_or(|(is_table, rows, ..)| rank > (*is_table, *rows)) {
            best = Some((rank.0, rank.1, stage, output, csv));
        }
    }
    Ok(best.map(|(_, _, stage, output, csv)| (stage, output, csv)))
}

/// The section of the main table.
pub(crate) fn first(outcome: &PipelineOutcome, room: &mut Room) -> Result<Option<Section>, StageError> {
    let Some((stage, output, csv)) = first_of(&tables(outcome))? else { return Ok(None) };
    let body = html! { (table(stage, output, Some(&csv), room)) (files(stage, output)) };
    Ok(Some(Section { anchor: "results", title: "Results", body }))
}

/// The largest table that waits for evaluations, as far as it is known: what a run of days shows on its way.
pub(crate) fn so_far(outcome: &PipelineOutcome, room: &mut Room) -> Option<Section> {
    let waiting = outcome.stages.iter().filter(|stage| stage.kind == "table" && stage.state != State::Done);
    let stage = waiting.max_by_key(|stage| evaluations(stage).count())?;
    let done = |input: &InputOutcome| {
        let source = outcome.stages.get(input.stage?).filter(|source| source.state == State::Done)?;
        source.outputs.iter().find(|output| output.name == input.from)
    };
    let items: Vec<InputItem<'_>> = evaluations(stage)
        .filter_map(|input| Some(InputItem { path: &done(input)?.path, labels: &input.labels }))
        .collect();
    if items.is_empty() {
        return None;
    }
    let known = items.len();
    let reference = stage.inputs.iter().find(|input| input.port == reference::PORT);
    let reference = reference.and_then(|input| input.path.as_deref());
    // A table that cannot be made must not prevent the report; its stage will fail and say why.
    let csv = Csv::parse(&crate::table::of_some(&stage.params, items, reference).ok()??)?;
    let labels: Vec<&Labels> = evaluations(stage).map(|input| &input.labels).collect();
    let shown = grid::Grid::with_gaps(&stage.params, &csv, &labels)?.table(&title_of(stage));
    let shown = Some(shown).filter(|shown| fits(shown, room));
    let body = html! {
        p { strong { (known) " of " (labels.len()) " evaluations are done." } " Cells without one are empty." }
        @if let Some(shown) = shown { (shown) } @else { p { "The table is too large for this page." } }
        p class="quiet" { "Stage " code { (stage.id) } " runs when all are done." }
    };
    Some(Section { anchor: "so-far", title: "Results so far", body })
}

fn evaluations(stage: &StageOutcome) -> impl Iterator<Item = &InputOutcome> {
    stage.inputs.iter().filter(|input| input.port == samples::PORT)
}

/// All other tables.
pub(crate) fn others(outcome: &PipelineOutcome, room: &mut Room) -> Result<Option<Section>, StageError> {
    let all = tables(outcome);
    let first = first_of(&all)?.map(|(_, output, _)| output);
    let rest: Vec<_> = all.into_iter().filter(|(_, output)| Some(*output) != first).collect();
    if rest.is_empty() {
        return Ok(None);
    }
    let mut bodies: Vec<Markup> = Vec::new();
    for (stage, output) in rest.iter().take(MOST_TABLES) {
        let csv = Csv::parse(&read(output)?);
        let shown = table(stage, output, csv.as_ref(), room);
        bodies.push(html! {
            details {
                summary { (title_of(stage)) @if stage.outputs.len() > 2 { " " span class="quiet" { (output.name) } } }
                (shown)
                (files(stage, output))
            }
        });
    }
    let more = rest.len().saturating_sub(MOST_TABLES);
    let body = html! {
        @for body in &bodies { (body) }
        @if more > 0 { p class="quiet" { "and " (count(more, "more table")) " in the results folder." } }
    };
    Ok(Some(Section { anchor: "tables", title: "More tables", body }))
}

/// As a grid where it is one of the kind `table` and fits, else as it is, as far as it fits.
fn table(stage: &StageOutcome, output: &OutputOutcome, csv: Option<&Csv>, room: &mut Room) -> Markup {
    let Some(csv) = csv else { return html! { p { "There is nothing to show here." } } };
    let title = title_of(stage);
    let grid = if stage.kind == "table" { grid::Grid::of(&stage.params, csv) } else { None };
    let grid = grid.map(|grid| grid.table(&title)).filter(|shown| fits(shown, room));
    grid.or_else(|| csv.table(&title, room)).unwrap_or_else(|| too_large(output))
}

fn fits(table: &Markup, room: &mut Room) -> bool {
    table.0.len() <= LARGEST_TABLE && room.take(table.0.len())
}

fn files(stage: &StageOutcome, output: &OutputOutcome) -> Markup {
    html! {
        p class="quiet" {
            "Stage " code { (stage.id) } @if output.file.is_some() { ": " (link(output)) }
        }
    }
}
