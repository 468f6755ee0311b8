//! The figures of the report: those of the pipeline, and default figures of scores and training logs that it does not
//! draw.

use std::collections::{BTreeMap, BTreeSet};

use dril_stage_api::outcome::{OutputOutcome, PipelineOutcome, StageOutcome, State};
use dril_stage_api::{Artifact, InputItem, Labels, StageError};
use maud::{Markup, PreEscaped, html};

use super::csvs::Csv;
use super::{Room, Section, count, is_replay, link, made, read, title_of, too_large};
use crate::figure::{FigureParams, Intervals, Layers, Line, Measure, Points, Scale, Scales, draw};

/// Images that are not our SVG are embedded up to this size, in bytes.
const LARGEST_IMAGE: u64 = 150_000;
/// Files in a default figure, at most.
const MOST_FILES: usize = 100;
/// Panels of a default figure, at most.
const MOST_PANELS: usize = 12;
/// Labels that distinguish repetitions of one experiment.
const REPETITIONS: [&str; 4] = ["seed", "fold", "run", "repetition"];

/// The pipeline's own figures.
pub(crate) fn section(outcome: &PipelineOutcome, room: &mut Room) -> Result<Option<Section>, StageError> {
    let all = made(outcome, |stage, output| output.artifact == Artifact::FIGURE && !is_replay(stage));
    if all.is_empty() {
        return Ok(None);
    }
    let mut bodies = Vec::new();
    for (stage, output) in all {
        bodies.push(figure(stage, output, room)?);
    }
    let body = html! { @for body in &bodies { (body) } };
    Ok(Some(Section { anchor: "figures", title: "Figures", body }))
}

fn figure(stage: &StageOutcome, output: &OutputOutcome, room: &mut Room) -> Result<Markup, StageError> {
    let title = title_of(stage);
    let image = if stage.kind == "figure" {
        let text = String::from_utf8_lossy(&read(output)?).into_owned();
        // The kind `figure` wrote it: there are only shapes and escaped text in it.
        room.take(text.len()).then(|| html! { (PreEscaped(text)) })
    } else {
        embedded(&title, output, room)?
    };
    Ok(html! {
        figure {
            @match image {
                Some(image) => { (frame(&title, &image)) },
                None if stage.kind == "figure" || media_type(output).is_some() => { (too_large(output)) },
                None => p { "A page cannot show this format, ." (output.extension) "." },
            }
            figcaption {
                @if stage.kind != "figure" && title != stage.id { (title) ". " }
                "Stage " code { (stage.id) }
                @if output.file.is_some() { ": " (link(output)) }
                @for data in stage.outputs.iter().filter(|other| stage.kind == "figure" && other.name == "csv") {
                    @if data.file.is_some() { ", " (link(data)) }
                }
            }
        }
    })
}

/// A frame that scrolls horizontally in narrow windows.
pub(crate) fn frame(title: &str, image: &Markup) -> Markup {
    html! { div class="wide" tabindex="0" role="region" aria-label=(format!("Figure: {title}")) { (image) } }
}

/// An image as a data URI, in which no script runs; `None` if it does not fit into the page.
pub(crate) fn embedded(
    title: &str,
    output: &OutputOutcome,
    room: &mut Room,
) -> Result<Option<Markup>, StageError> {
    let Some(kind) = media_type(output) else { return Ok(None) };
    if output.bytes > LARGEST_IMAGE || !room.take(output.bytes as usize * 4 / 3) {
        return Ok(None);
    }
    let address = format!("data:{kind};base64,{}", base64(&read(output)?));
    Ok(Some(html! { img src=(address) alt=(title); }))
}

/// The media type of an image that browsers show.
fn media_type(output: &OutputOutcome) -> Option<&'static str> {
    Some(match output.extension.as_str() {
        "svg" => "image/svg+xml",
        "png" => "image/png",
        "gif" => "image/gif",
        "jpg" | "jpeg" => "image/jpeg",
        "webp" => "image/webp",
        _ => return None,
    })
}

fn base64(bytes: &[u8]) -> String {
    const LETTERS: &[u8; 64] = b"ABCDEFGHIJKLMNOPQRSTUVWXYZabcdefghijklmnopqrstuvwxyz0123456789+/";
    let mut text = String::with_capacity(bytes.len().div_ceil(3) * 4);
    for chunk in bytes.chunks(3) {
        let three = [chunk[0], chunk.get(1).copied().unwrap_or(0), chunk.get(2).copied().unwrap_or(0)];
        let bits = three.iter().fold(0_usize, |bits, byte| bits << 8 | usize::from(*byte));
        for n in 0..4 {
            let letter = char::from(LETTERS[bits >> (18 - 6 * n) & 63]);
            text.push(if n <= chunk.len() { letter } else { '=' });
        }
    }
    text
}

/// The label that says which of two compared runs made a file; its values are drawn over each other.
pub(crate) const SIDE: &str = "side";

/// An output with its labels, in the order of the matrix.
pub(crate) type Member<'o> = (Vec<(String, String)>, &'o OutputOutcome);

/// Default figures that are not on the page.
#[derive(Default)]
pub(crate) struct Missing {
    too_large: Vec<String>,
    impossible: Vec<String>,
}

impl Missing {
    /// The figure, if it could be drawn and fits; otherwise its name is kept for [`Self::note`].
    pub(crate) fn keep(&mut self, name: String, svg: Option<String>, room: &mut Room) -> Option<Markup> {
        match svg {
            Some(svg) if room.take(svg.len()) => return Some(PreEscaped(svg)),
            Some(_) => self.too_large.push(name),
            None => self.impossible.push(name),
        }
        None
    }

    /// Says what is missing, and why.
    pub(crate) fn note(&self) -> Markup {
        let list = |names: &[String]| {
            html! { @for (n, name) in names.iter().enumerate() { @if n > 0 { ", " } code { (name) } } "." }
        };
        html! {
            @if !self.too_large.is_empty() {
                p class="quiet" { "These figures are too large for this page: " (list(&self.too_large)) }
            }
            @if !self.impossible.is_empty() {
                p class="quiet" { "No default figure can be drawn of " (list(&self.impossible)) }
            }
        }
    }
}

/// How many files a default figure draws: `3 files`, or `the first 100 of 120 files`.
pub(crate) fn files(members: &[Member<'_>]) -> String {
    let all = count(members.len(), "file");
    if members.len() > MOST_FILES { format!("the first {MOST_FILES} of {all}") } else { all }
}

/// Default figures of scores and training logs that no figure of the pipeline reads.
pub(crate) fn automatic(outcome: &PipelineOutcome, room: &mut Room) -> Result<Option<Section>, StageError> {
    let figures = outcome.stages.iter().filter(|stage| stage.kind == "figure" && stage.state == State::Done);
    let drawn: BTreeSet<(usize, &str)> = figures
        .flat_map(|figure| &figure.inputs)
        .filter_map(|input| Some((input.stage?, input.from.as_str())))
        .collect();
    let wanted = [Artifact::SCORES, Artifact::TRAINING_LOG];
    let mut groups: Vec<(&str, &str, Vec<Member<'_>>)> = Vec::new();
    for (at, stage) in outcome.stages.iter().enumerate() {
        for output in &stage.outputs {
            let is_shown = drawn.contains(&(at, &output.name)) || is_replay(stage);
            if stage.state != State::Done || is_shown || !wanted.contains(&output.artifact) {
                continue;
            }
            let member = (stage.labels.clone(), output);
            match groups.iter_mut().find(|(name, port, _)| *name == stage.name && *port == output.name) {
                Some((_, _, members)) => members.push(member),
                None => groups.push((&stage.name, &output.name, vec![member])),
            }
        }
    }
    let (mut bodies, mut missing) = (Vec::new(), Missing::default());
    for (name, port, members) in &groups {
        let title = format!("{name}.{port}");
        if let Some(figure) = missing.keep(title.clone(), figure_of(name, port, members)?, room) {
            bodies.push(html! {
                details {
                    summary { code { (title) } " " span class="quiet" { (files(members)) } }
                    figure { (frame(&title, &figure)) }
                }
            });
        }
    }
    let body = html! {
        p class="quiet" { "Scores and training logs that no finished figure of the pipeline draws." }
        @for body in &bodies { (body) }
        (missing.note())
    };
    Ok((!groups.is_empty()).then_some(Section { anchor: "curves", title: "Scores and training logs", body }))
}

/// The default figure of all files of one output; `None` if there is nothing to draw.
pub(crate) fn figure_of(
    name: &str,
    port: &str,
    members: &[Member<'_>],
) -> Result<Option<String>, StageError> {
    let members = &members[..members.len().min(MOST_FILES)];
    let labels: Vec<Labels> =
        members.iter().map(|(labels, _)| labels.iter().cloned().collect::<BTreeMap<_, _>>()).collect();
    let items: Vec<InputItem<'_>> = members
        .iter()
        .zip(&labels)
        .map(|((_, output), labels)| InputItem { path: &output.path, labels })
        .collect();
    let mut params = blank(format!("{name}.{port}"));
    // Axes of the matrix, the fastest last: it gets the colours, repetitions are taken together.
    let axes: Vec<&str> = members[0].0.iter().map(|(axis, _)| axis.as_str()).collect();
    let (repetitions, axes): (Vec<&str>, Vec<&str>) =
        axes.into_iter().partition(|axis| REPETITIONS.contains(axis));
    params.pool = repetitions.into_iter().map(str::to_owned).collect();
    if members[0].1.artifact == Artifact::SCORES {
        params.y = vec![Measure::Column("score".to_owned())];
        params.layers = Layers { interval: Some(Intervals {}), ..Layers::default() };
        params.categories = axes.into_iter().map(str::to_owned).collect();
    } else {
        let Some(csv) = Csv::parse(&read(members[0].1)?) else { return Ok(None) };
        curves(&mut params, &csv, &axes, members.len());
        if params.y.is_empty() {
            return Ok(None);
        }
    }
    // A figure that cannot be drawn must not prevent the report.
    Ok(draw(&params, &items, None).ok().map(|drawing| drawing.svg))
}

/// Chooses the columns of a training log to draw.
fn curves(params: &mut FigureParams, csv: &Csv, axes: &[&str], files: usize) {
    let has = |name: &str| csv.at(name).is_some();
    let losses: Vec<&str> =
        csv.headers.iter().map(String::as_str).filter(|name| name.ends_with("_loss")).collect();
    params.x = ["step", "epoch", "episode", "update"].into_iter().find(|name| has(name)).map(str::to_owned);
    let column = |name: &str| Measure::Column(name.to_owned());
    if has("score_mean_10") {
        params.y = vec![column("score_mean_10")];
    } else if !losses.is_empty() {
        params.y = losses.into_iter().map(column).collect();
        params.scale = Scales { y: Scale::Log, ..Scales::default() };
    } else {
        let first = csv.headers.iter().find(|name| Some(*name) != params.x.as_ref());
        params.y = first.map(|name| column(name)).into_iter().collect();
    }
    let several = params.y.len() > 1;
    let keep = |names: &[&str]| names.iter().map(|name| (*name).to_owned()).collect::<Vec<String>>();
    match axes {
        [] => {}
        [rest @ .., side] if *side == SIDE => {
            params.columns = keep(rest);
            params.colour = keep(&[side]);
            params.rows = if several { keep(&["measure"]) } else { Vec::new() };
        }
        [only] if !several => params.colour = keep(&[only]),
        [rest @ .., last] if !several && files <= MOST_PANELS * 6 => {
            params.columns = keep(rest);
            params.colour = keep(&[last]);
        }
        all => params.columns = keep(all),
    }
    let few = csv.rows.len() < 3;
    params.layers =
        Layers { line: (!few).then(Line::default), points: few.then_some(Points {}), ..Layers::default() };
}

fn blank(title: String) -> FigureParams {
    FigureParams {
        title,
        preset: None,
        x: None,
        y: Vec::new(),
        rows: Vec::new(),
        columns: Vec::new(),
        colour: Vec::new(),
        pool: Vec::new(),
        categories: Vec::new(),
        layers: Layers::default(),
        rules: Vec::new(),
        scale: Scales::default(),
        range: Default::default(),
        x_title: String::new(),
        y_title: String::new(),
        note: String::new(),
        profile: String::new(),
        full_profile: None,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn base64_is_that_of_rfc_4648() {
        for (bytes, text) in
            [("", ""), ("f", "Zg=="), ("fo", "Zm8="), ("foo", "Zm9v"), ("foobar", "Zm9vYmFy")]
        {
            assert_eq!(base64(bytes.as_bytes()), text);
        }
    }
}
