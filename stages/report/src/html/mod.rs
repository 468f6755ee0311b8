//! The page about a pipeline's results: one HTML file that fetches nothing, runs no script and reads without style
//! sheets. A pipeline needs no word of configuration for it.
//!
//! It is a function of the [`Outcome`] and of the files that it names: equal stores give equal bytes.

mod csvs;
mod figures;
mod findings;
mod graph;
mod grid;
mod head;
mod provenance;
mod style;
mod tables;

use dril_stage_api::StageError;
use dril_stage_api::outcome::{Outcome, OutputOutcome, StageOutcome, State};
use maud::{DOCTYPE, Markup, PreEscaped, html};

/// The first line of every page, by which a later run knows that it may write over it.
pub const MARK: &str = "<!-- made by dril-pipe report; a later run writes over it -->\n";

/// Figures and tables stop being put into the page once it has so many bytes; the rest are links.
const ROOM: usize = 1_700_000;

/// A part of the page: its anchor, its heading, and what stands in it.
pub(crate) struct Section {
    pub(crate) anchor: &'static str,
    pub(crate) title: &'static str,
    pub(crate) body: Markup,
}

/// How much still fits into the page.
pub(crate) struct Room {
    left: usize,
}

impl Room {
    /// Takes so many bytes; false where they do not fit.
    pub(crate) fn take(&mut self, bytes: usize) -> bool {
        let fits = bytes <= self.left;
        if fits {
            self.left -= bytes;
        }
        fits
    }
}

/// Writes the page.
///
/// # Errors
/// A result that the outcome names cannot be read.
pub fn page(outcome: &Outcome) -> Result<String, StageError> {
    let mut room = Room { left: ROOM };
    let findings = findings::section(outcome)?;
    let sections: Vec<Section> = [
        tables::first(outcome)?,
        findings,
        figures::section(outcome, &mut room)?,
        figures::automatic(outcome, &mut room)?,
        tables::others(outcome, &mut room)?,
        Some(graph::section(outcome)),
        Some(provenance::section(outcome)),
        Some(provenance::reproduce(outcome)),
    ]
    .into_iter()
    .flatten()
    .collect();
    let title = format!("{}: results", outcome.pipeline);
    let body = html! {
        (DOCTYPE)
        html lang="en" {
            head {
                meta charset="utf-8";
                meta name="viewport" content="width=device-width, initial-scale=1";
                meta name="color-scheme" content="light dark";
                meta http-equiv="Content-Security-Policy"
                    content="default-src 'none'; img-src data: 'self'; style-src 'unsafe-inline'";
                title { (title) }
                style { (PreEscaped(style::SHEET)) }
            }
            body {
                header { (head::head(outcome)?) }
                nav aria-label="Contents" {
                    ul {
                        @for section in &sections {
                            li { a href=(format!("#{}", section.anchor)) { (section.title) } }
                        }
                    }
                }
                main {
                    @for section in &sections {
                        section aria-labelledby=(section.anchor) {
                            h2 id=(section.anchor) { (section.title) }
                            (section.body)
                        }
                    }
                }
                footer { p { "Made by " (outcome.tool) "." } }
            }
        }
    };
    Ok(format!("{MARK}{}\n", body.into_string()))
}

/// The stages that are done and have an output that `fits`, with it, in the order of the pipeline.
pub(crate) fn made(
    outcome: &Outcome,
    fits: impl Fn(&StageOutcome, &OutputOutcome) -> bool,
) -> Vec<(&StageOutcome, &OutputOutcome)> {
    let stages = outcome.stages.iter().filter(|stage| stage.state == State::Done);
    let outputs = stages.flat_map(|stage| stage.outputs.iter().map(move |output| (stage, output)));
    outputs.filter(|(stage, output)| fits(stage, output)).collect()
}

/// What the content of an output is.
pub(crate) fn read(output: &OutputOutcome) -> Result<Vec<u8>, StageError> {
    std::fs::read(&output.path).map_err(StageError::io("cannot read", &output.path))
}

/// The title that the parameters of a stage give, or its id.
pub(crate) fn title_of(stage: &StageOutcome) -> String {
    let title = stage.params.get("title").and_then(|title| title.as_str());
    title.filter(|title| !title.trim().is_empty()).map_or_else(|| stage.id.clone(), str::to_owned)
}

/// A link to the copy in the results folder; nothing where there is none.
pub(crate) fn link(output: &OutputOutcome) -> Markup {
    html! {
        @if let Some(file) = &output.file { a href=(encoded(file)) download { (file) } }
    }
}

/// A file's name as a relative address.
pub(crate) fn encoded(name: &str) -> String {
    let mut address = String::from("./");
    for byte in name.bytes() {
        if byte.is_ascii_alphanumeric() || b"-_.~".contains(&byte) {
            address.push(byte.into());
        } else {
            address.push_str(&format!("%{byte:02X}"));
        }
    }
    address
}

/// `1 stage`, `3 stages`.
pub(crate) fn count(number: usize, what: &str) -> String {
    if number == 1 { format!("1 {what}") } else { format!("{number} {what}s") }
}

/// Seconds for people.
pub(crate) fn duration(seconds: f64) -> String {
    match seconds {
        s if s < 0.95 => format!("{s:.1} s"),
        s if s < 99.5 => format!("{s:.0} s"),
        s if s < 5_970.0 => format!("{:.0} min", s / 60.0),
        s if s < 359_000.0 => format!("{:.1} h", s / 3600.0),
        s => format!("{:.1} d", s / 86_400.0),
    }
}
