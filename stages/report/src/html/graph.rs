//! The DAG of the pipeline as SVG: one box per stage of the file, coloured by the state of its instances.

use std::collections::BTreeSet;
use std::fmt::Write as _;

use dril_stage_api::outcome::{PipelineOutcome, State};
use maud::{PreEscaped, html};

use super::Section;
use crate::figure::escape;

/// A box in pixels, and the room between two.
const BOX: (i32, i32) = (124, 38);
const GAP: (i32, i32) = (32, 8);
/// Graphs with more stages are not drawn.
const MOST: usize = 150;

/// A stage of the file.
struct Node<'o> {
    name: &'o str,
    kind: &'o str,
    instances: usize,
    done: usize,
    failed: usize,
    /// The column: to the right of all its inputs.
    level: usize,
}

/// The section with the drawing.
pub(crate) fn section(outcome: &PipelineOutcome) -> Section {
    let (nodes, edges) = layered(outcome);
    let body = if nodes.len() > MOST {
        html! { p { (nodes.len()) " stages are too many to draw." } }
    } else {
        html! {
            div class="wide" tabindex="0" role="region" aria-label="The graph of the stages" {
                (PreEscaped(drawing(&nodes, &edges)))
            }
            p class="quiet" {
                "One box per stage, with its kind and number of instances; arrows point to the stages that read its outputs. "
                "Solid: all instances up to date; dashed: some are not; thick red: some failed."
            }
        }
    };
    Section { anchor: "stages", title: "Stages", body }
}

/// The stages of the file with their columns, and the edges between them.
fn layered(outcome: &PipelineOutcome) -> (Vec<Node<'_>>, BTreeSet<(usize, usize)>) {
    let mut nodes: Vec<Node<'_>> = Vec::new();
    let mut places = Vec::new();
    for stage in &outcome.stages {
        let at = nodes.iter().position(|node| node.name == stage.name).unwrap_or_else(|| {
            let (name, kind) = (stage.name.as_str(), stage.kind.as_str());
            nodes.push(Node { name, kind, instances: 0, done: 0, failed: 0, level: 0 });
            nodes.len() - 1
        });
        nodes[at].instances += 1;
        nodes[at].done += usize::from(stage.state == State::Done);
        nodes[at].failed += usize::from(matches!(stage.state, State::Failed(_)));
        places.push(at);
    }
    let mut edges = BTreeSet::new();
    for (stage, to) in outcome.stages.iter().zip(&places) {
        let sources = stage.inputs.iter().filter_map(|input| places.get(input.stage?));
        edges.extend(sources.filter(|from| *from != to).map(|from| (*from, *to)));
    }
    // As many rounds as the longest way is long; instances of one stage may read each other's neighbours both ways.
    for _ in 0..nodes.len() {
        let mut moved = false;
        for (from, to) in &edges {
            let level = nodes[*from].level + 1;
            if nodes[*to].level < level && level < nodes.len() {
                nodes[*to].level = level;
                moved = true;
            }
        }
        if !moved {
            break;
        }
    }
    (nodes, edges)
}

fn drawing(nodes: &[Node<'_>], edges: &BTreeSet<(usize, usize)>) -> String {
    let columns = 1 + nodes.iter().map(|node| node.level).max().unwrap_or(0);
    let mut boxes = vec![0_i32; columns];
    nodes.iter().for_each(|node| boxes[node.level] += 1);
    let most = boxes.iter().max().copied().unwrap_or(1);
    let mut filled = vec![0_i32; columns];
    let mut corners = Vec::new();
    for node in nodes {
        let row = &mut filled[node.level];
        // Short columns are centred, so that edges stay short.
        let above = (most - boxes[node.level]) * (BOX.1 + GAP.1) / 2;
        corners.push((4 + node.level as i32 * (BOX.0 + GAP.0), 4 + above + *row * (BOX.1 + GAP.1)));
        *row += 1;
    }
    let width = columns as i32 * (BOX.0 + GAP.0) - GAP.0 + 8;
    let height = most * (BOX.1 + GAP.1) - GAP.1 + 8;
    let mut svg = format!(
        "<svg xmlns=\"http://www.w3.org/2000/svg\" viewBox=\"0 0 {width} {height}\" width=\"{width}\" \
         height=\"{height}\" role=\"img\" aria-label=\"The graph of the stages\" font-family=\"system-ui,sans-serif\">\n"
    );
    for (from, to) in edges {
        let (start, end) = (corners[*from], corners[*to]);
        let (x, y) = (start.0 + BOX.0, start.1 + BOX.1 / 2);
        let (to_x, to_y) = (end.0, end.1 + BOX.1 / 2);
        let bend = ((to_x - x) / 2).max(16);
        let _ = writeln!(
            svg,
            "<path d=\"M{x} {y}C{} {y} {} {to_y} {to_x} {to_y}\" fill=\"none\" stroke=\"currentColor\" \
             stroke-opacity=\".35\"/><path d=\"M{to_x} {to_y}l-6-3v6z\" fill=\"currentColor\" fill-opacity=\".6\"/>",
            x + bend,
            to_x - bend
        );
    }
    for (node, (x, y)) in nodes.iter().zip(corners) {
        let style = if node.failed > 0 {
            "stroke=\"#b00020\" stroke-width=\"2.5\""
        } else if node.done == node.instances {
            "stroke=\"#009e73\" stroke-width=\"1.5\""
        } else {
            "stroke=\"currentColor\" stroke-dasharray=\"4 3\""
        };
        let subtitle = match node.instances {
            1 => node.kind.to_owned(),
            n if node.done == n => format!("{} × {n}", node.kind),
            n => format!("{} × {n}, {} done", node.kind, node.done),
        };
        let (width, height) = BOX;
        let _ = writeln!(
            svg,
            "<g><title>{}</title><rect x=\"{x}\" y=\"{y}\" width=\"{width}\" height=\"{height}\" rx=\"4\" fill=\"none\" \
             {style}/><text x=\"{}\" y=\"{}\" font-size=\"12\" font-weight=\"600\" fill=\"currentColor\">{}</text>\
             <text x=\"{}\" y=\"{}\" font-size=\"11\" fill=\"currentColor\">{}</text></g>",
            escape(node.name),
            x + 8,
            y + 16,
            escape(&cut(node.name, 16)),
            x + 8,
            y + 31,
            escape(&cut(&subtitle, 17))
        );
    }
    svg + "</svg>\n"
}

/// The text, truncated if it does not fit.
fn cut(text: &str, most: usize) -> String {
    if text.chars().count() <= most {
        return text.to_owned();
    }
    text.chars().take(most - 1).chain(['…']).collect()
}
