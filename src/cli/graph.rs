//! `dril-pipe graph`: the stages and what they read from each other, as DOT or Mermaid. Needs no store.

use std::collections::BTreeMap;
use std::fmt::Write as _;
use std::process::ExitCode;

use dril_stage_api::Registry;

use super::args::{GraphArgs, GraphFormat};
use super::pipeline;
use super::terminal::{print, printable};
use crate::error::Error;
use crate::resolve::{From, Graph};

pub(super) fn main(args: &GraphArgs, registry: &Registry) -> Result<ExitCode, Error> {
    let graph = pipeline::load(&args.pipeline, registry)?;
    let drawing = Drawing::of(&graph, args.instances);
    print(&match args.format {
        GraphFormat::Dot => drawing.dot(),
        GraphFormat::Mermaid => drawing.mermaid(),
    })?;
    Ok(ExitCode::SUCCESS)
}

/// Boxes and arrows, without a language yet.
#[derive(Debug, Default, PartialEq, Eq)]
struct Drawing {
    title: String,
    /// Title and subtitle of each box.
    boxes: Vec<(String, String)>,
    /// From box, to box, and what flows, in the order of the consumers' ports.
    arrows: Vec<(usize, usize, String)>,
}

impl Drawing {
    fn of(graph: &Graph, instances: bool) -> Self {
        let mut drawing = Self { title: graph.pipeline.clone(), ..Self::default() };
        let boxes = drawing.place(graph, instances);
        let mut flows: BTreeMap<(usize, usize), Vec<&str>> = BTreeMap::new();
        for index in graph.stages.node_indices() {
            for source in graph.stages[index].inputs.iter().flat_map(|wire| &wire.sources) {
                let From::Stage { stage, output } = &source.from else { continue };
                let flow = flows.entry((boxes[stage.index()], boxes[index.index()])).or_default();
                if !flow.contains(output) {
                    flow.push(output);
                }
            }
        }
        drawing.arrows = flows.into_iter().map(|((from, to), flow)| (from, to, flow.join(", "))).collect();
        drawing
    }

    /// Makes the boxes; gives each node's.
    fn place(&mut self, graph: &Graph, instances: bool) -> Vec<usize> {
        let mut by_name: BTreeMap<&str, usize> = BTreeMap::new();
        let mut sizes: Vec<usize> = Vec::new();
        let mut places = Vec::with_capacity(graph.stages.node_count());
        for stage in graph.stages.node_weights() {
            let next = self.boxes.len();
            let at = if instances { next } else { *by_name.entry(&stage.name).or_insert(next) };
            if at == next {
                let title = if instances { &stage.id } else { &stage.name };
                self.boxes.push((title.to_string(), stage.kind.name().to_owned()));
                sizes.push(0);
            }
            sizes[at] += 1;
            places.push(at);
        }
        for ((_, subtitle), size) in self.boxes.iter_mut().zip(sizes).filter(|(_, size)| *size > 1) {
            *subtitle += &format!(" × {size}");
        }
        places
    }

    fn dot(&self) -> String {
        let mut text = format!("digraph \"{}\" {{\n  rankdir=LR;\n", dot_text(&self.title));
        text += "  node [shape=box, style=rounded, fontname=\"sans-serif\"];\n";
        text += "  edge [fontname=\"sans-serif\", fontsize=10];\n";
        for (number, (title, subtitle)) in self.boxes.iter().enumerate() {
            let _ = writeln!(text, "  n{number} [label=\"{}\\n{}\"];", dot_text(title), dot_text(subtitle));
        }
        for (from, to, flow) in &self.arrows {
            let _ = writeln!(text, "  n{from} -> n{to} [label=\"{}\"];", dot_text(flow));
        }
        text + "}\n"
    }

    fn mermaid(&self) -> String {
        let mut text = "flowchart LR\n".to_owned();
        for (number, (title, subtitle)) in self.boxes.iter().enumerate() {
            let _ = writeln!(text, "  n{number}[\"{}<br>{}\"]", html_text(title), html_text(subtitle));
        }
        for (from, to, flow) in &self.arrows {
            let _ = writeln!(text, "  n{from} -->|\"{}\"| n{to}", html_text(flow));
        }
        text
    }
}

fn dot_text(text: &str) -> String {
    printable(text).replace('\\', "\\\\").replace('"', "\\\"").replace('\n', " ")
}

/// Mermaid reads labels as HTML with `#…;` for its own escapes.
fn html_text(text: &str) -> String {
    let mut safe = String::new();
    for c in printable(text).chars() {
        match c {
            '#' => safe.push_str("#35;"),
            '"' => safe.push_str("#quot;"),
            '<' => safe.push_str("#lt;"),
            '>' => safe.push_str("#gt;"),
            '&' => safe.push_str("#amp;"),
            '\n' => safe.push(' '),
            c => safe.push(c),
        }
    }
    safe
}

#[cfg(test)]
mod tests {
    use super::*;

    fn drawing() -> Drawing {
        Drawing {
            title: "a \"b\"".into(),
            boxes: vec![("x[t=\"<1>\"]".into(), "emit".into()), ("y".into(), "concat × 2".into())],
            arrows: vec![(0, 1, "text".into())],
        }
    }

    #[test]
    fn names_with_quotes_do_not_break_the_languages() {
        assert!(drawing().dot().contains(r#"n0 [label="x[t=\"<1>\"]\nemit"];"#), "{}", drawing().dot());
        assert!(drawing().mermaid().contains(r#"n0["x[t=#quot;#lt;1#gt;#quot;]<br>emit"]"#));
    }
}
