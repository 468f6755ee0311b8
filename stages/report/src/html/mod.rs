//! The report: one HTML file about a pipeline's results that makes no requests, has no scripts and is readable without
//! style sheets. It needs no configuration.
//!
//! It is a function of the [`PipelineOutcome`] and of the files that it names: equal stores give equal bytes.

mod against;
mod csvs;
mod figures;
mod findings;
mod graph;
mod grid;
mod head;
mod provenance;
mod replays;
mod style;
mod tables;

use dril_stage_api::StageError;
use dril_stage_api::outcome::{OutputOutcome, PipelineOutcome, StageOutcome, State};
use maud::{DOCTYPE, Markup, PreEscaped, html};

/// The first line of every report; a later run overwrites only files that begin with it.
pub const MARK: &str = "<!-- made by dril-pipe report; a later run writes over it -->\n";

/// Bytes of all sections, at most; what does not fit is a link. With head and style sheet the page stays below 2 MB.
const ROOM: usize = 1_900_000;
/// Bytes of the provenance of the stages, at most.
const PROVENANCE: usize = 450_000;
/// Tables are shown up to this size in bytes, so that one leaves room for others.
pub(crate) const LARGEST_TABLE: usize = 400_000;

/// A section of the page: anchor, heading and content.
pub(crate) struct Section {
    pub(crate) anchor: &'static str,
    pub(crate) title: &'static str,
    pub(crate) body: Markup,
}

/// Bytes that still fit into the page.
pub(crate) struct Room {
    left: usize,
}

impl Room {
    /// Reserves bytes; false if they do not fit.
    pub(crate) fn take(&mut self, bytes: usize) -> bool {
        let fits = bytes <= self.left;
        if fits {
            self.left -= bytes;
        }
        fits
    }

    /// Reserves the bytes of a section, also those of its texts, for which it need not ask.
    fn section(
        &mut self,
        write: impl FnOnce(&mut Self) -> Result<Option<Section>, StageError>,
    ) -> Result<Option<Section>, StageError> {
        let before = self.left;
        let section = write(self)?;
        let bytes = section.as_ref().map_or(0, |section| section.body.0.len());
        self.left = self.left.min(before.saturating_sub(bytes));
        Ok(section)
    }
}

/// The note in the place of what is too large, with a link to the file if there is one.
pub(crate) fn too_large(output: &OutputOutcome) -> Markup {
    html! { p { "Too large for this page" @if output.file.is_some() { ": " (link(output)) } "." } }
}

/// Writes the page. With `other`, the results of another run under its name, it begins with a comparison.
///
/// # Errors
/// A result that an outcome names cannot be read.
pub fn page(
    outcome: &PipelineOutcome,
    other: Option<(&str, &PipelineOutcome)>,
) -> Result<String, StageError> {
    let mut room = Room { left: ROOM };
    // Sections of texts take their bytes first; tables and figures share the rest.
    let mut provenance = Room { left: PROVENANCE };
    let provenance = room.section(|_| Ok(Some(provenance::section(outcome, &mut provenance))))?;
    let graph = room.section(|_| Ok(Some(graph::section(outcome))))?;
    let findings = room.section(|_| findings::section(outcome))?;
    let compared = room.section(|room| {
        other.map(|(name, other)| against::section(outcome, name, other, room)).transpose()
    })?;
    let sections: Vec<Section> = [
        compared,
        room.section(|room| Ok(tables::so_far(outcome, room)))?,
        room.section(|room| tables::first(outcome, room))?,
        findings,
        room.section(|room| figures::section(outcome, room))?,
        room.section(|room| replays::section(outcome, room))?,
        room.section(|room| figures::automatic(outcome, room))?,
        room.section(|room| tables::others(outcome, room))?,
        graph,
        provenance,
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
    outcome: &PipelineOutcome,
    fits: impl Fn(&StageOutcome, &OutputOutcome) -> bool,
) -> Vec<(&StageOutcome, &OutputOutcome)> {
    let stages = outcome.stages.iter().filter(|stage| stage.state == State::Done);
    let outputs = stages.flat_map(|stage| stage.outputs.iter().map(move |output| (stage, output)));
    outputs.filter(|(stage, output)| fits(stage, output)).collect()
}

/// The content of an output.
pub(crate) fn read(output: &OutputOutcome) -> Result<Vec<u8>, StageError> {
    std::fs::read(&output.path).map_err(StageError::io("cannot read", &output.path))
}

/// The parameter `title` of a stage, or its id.
pub(crate) fn title_of(stage: &StageOutcome) -> String {
    let title = stage.params.get("title").and_then(|title| title.as_str());
    title.filter(|title| !title.trim().is_empty()).map_or_else(|| stage.id.clone(), str::to_owned)
}

/// True for a stage that rendered an episode: it has a section of its own.
pub(crate) fn is_replay(stage: &StageOutcome) -> bool {
    stage.kind == "trace" && stage.outputs.iter().any(|output| output.name == "strip")
}

/// A link to the copy in the results folder, if there is one.
pub(crate) fn link(output: &OutputOutcome) -> Markup {
    html! {
        @if let Some(file) = &output.file { a href=(encoded(file)) download { (file) } }
    }
}

/// A file name as a relative URL.
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

/// A human-readable duration.
pub(crate) fn duration(seconds: f64) -> String {
    match seconds {
        s if s < 0.95 => format!("{s:.1} s"),
        s if s < 99.5 => format!("{s:.0} s"),
        s if s < 5_970.0 => format!("{:.0} min", s / 60.0),
        s if s < 359_000.0 => format!("{:.1} h", s / 3600.0),
        s => format!("{:.1} d", s / 86_400.0),
    }
}
