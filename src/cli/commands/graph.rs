//! `dril-pipe graph`: the DAG of stages as DOT, Mermaid or JSON. Does not read the store.

use std::collections::BTreeMap;
use std::fmt::Write as _;
use std::process::ExitCode;

use dril_stage_api::Registry;
use serde_json::{Value, json};

use crate::cli::args::{GraphArgs, GraphFormat};
use crate::cli::pipeline;
use crate::cli::terminal::{print, printable};
use crate::error::Error;
use crate::resolve::{Graph, Origin};

pub(in crate::cli) fn main(args: &GraphArgs, registry: &Registry) -> Result<ExitCode, Error> {
    let graph = pipeline::source(&args.pipeline).load(registry)?;
    let drawing = Drawing::of(&graph, args.instances);
    print(&match args.format {
        GraphFormat::Dot => drawing.dot(),
        GraphFormat::Mermaid => drawing.mermaid(),
        GraphFormat::Json => drawing.json(),
    })?;
    Ok(ExitCode::SUCCESS)
}

/// Nodes and edges, independent of the output format.
#[derive(Debug, Default, PartialEq, Eq)]
struct Drawing {
    title: String,
    boxes: Vec<Node>,
    /// From node, to node, and the outputs, in the order of the consumer's ports.
    arrows: Vec<(usize, usize, Vec<String>)>,
}

#[derive(Debug, PartialEq, Eq)]
struct Node {
    title: String,
    kind: String,
    /// Number of stage instances.
    size: usize,
}

impl Node {
    fn subtitle(&self) -> String {
        match self.size {
            1 => self.kind.clone(),
            size => format!("{} × {size}", self.kind),
        }
    }
}

impl Drawing {
    fn of(graph: &Graph, instances: bool) -> Self {
        let mut drawing = Self { title: graph.pipeline.clone(), ..Self::default() };
        let boxes = drawing.place(graph, instances);
        let mut flows: BTreeMap<(usize, usize), Vec<String>> = BTreeMap::new();
        for index in graph.stages.node_indices() {
            for source in graph.stages[index].inputs.iter().flat_map(|wire| &wire.sources) {
                let Origin::Stage { stage, output } = &source.from else { continue };
                let flow = flows.entry((boxes[stage.index()], boxes[index.index()])).or_default();
                if flow.iter().all(|known| known != output) {
                    flow.push((*output).to_owned());
                }
            }
        }
        drawing.arrows = flows.into_iter().map(|((from, to), flow)| (from, to, flow)).collect();
        drawing
    }

    /// Makes the boxes; gives each node's.
    fn place(&mut self, graph: &Graph, instances: bool) -> Vec<usize> {
        let mut by_name: BTreeMap<&str, usize> = BTreeMap::new();
        let mut places = Vec::with_capacity(graph.stages.node_count());
        for stage in graph.stages.node_weights() {
            let next = self.boxes.len();
            let at = if instances { next } else { *by_name.entry(&stage.name).or_insert(next) };
            if at == next {
                let title = if instances { &stage.id } else { &stage.name };
                self.boxes.push(Node {
                    title: title.to_string(),
                    kind: stage.kind.name().to_owned(),
                    size: 0,
                });
            }
            self.boxes[at].size += 1;
            places.push(at);
        }
        places
    }

    fn dot(&self) -> String {
        let mut text = format!("digraph \"{}\" {{\n  rankdir=LR;\n", dot_text(&self.title));
        text += "  node [shape=box, style=rounded, fontname=\"sans-serif\"];\n";
        text += "  edge [fontname=\"sans-serif\", fontsize=10];\n";
        for (number, found) in self.boxes.iter().enumerate() {
            let (title, subtitle) = (dot_text(&found.title), dot_text(&found.subtitle()));
            let _ = writeln!(text, "  n{number} [label=\"{title}\\n{subtitle}\"];");
        }
        for (from, to, flow) in &self.arrows {
            let _ = writeln!(text, "  n{from} -> n{to} [label=\"{}\"];", dot_text(&flow.join(", ")));
        }
        text + "}\n"
    }

    fn mermaid(&self) -> String {
        let mut text = "flowchart LR\n".to_owned();
        for (number, found) in self.boxes.iter().enumerate() {
            let (title, subtitle) = (html_text(&found.title), html_text(&found.subtitle()));
            let _ = writeln!(text, "  n{number}[\"{title}<br>{subtitle}\"]");
        }
        for (from, to, flow) in &self.arrows {
            let _ = writeln!(text, "  n{from} -->|\"{}\"| n{to}", html_text(&flow.join(", ")));
        }
        text
    }

    fn json(&self) -> String {
        let stage =
            |found: &Node| json!({ "name": found.title, "kind": found.kind, "instances": found.size });
        let name = |number: &usize| &self.boxes[*number].title;
        let stages: Vec<Value> = self.boxes.iter().map(stage).collect();
        let edges = self.arrows.iter();
        let edges =
            edges.map(|(from, to, flow)| json!({ "from": name(from), "to": name(to), "outputs": flow }));
        let edges: Vec<Value> = edges.collect();
        format!("{:#}\n", json!({ "pipeline": self.title, "stages": stages, "edges": edges }))
    }
}

fn dot_text(text: &str) -> String {
    printable(text).replace('\\', "\\\\").replace('"', "\\\"").replace('\n', " ")
}

/// Mermaid parses labels as HTML, with `#…;` for its own escapes.
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
            boxes: vec![
                Node { title: "x[t=\"<1>\"]".into(), kind: "emit".into(), size: 1 },
                Node { title: "y".into(), kind: "concat".into(), size: 2 },
            ],
            arrows: vec![(0, 1, vec!["text".into()])],
        }
    }

    #[test]
    fn names_with_quotes_do_not_break_the_languages() {
        assert!(drawing().dot().contains(r#"n0 [label="x[t=\"<1>\"]\nemit"];"#), "{}", drawing().dot());
        assert!(drawing().mermaid().contains(r#"n0["x[t=#quot;#lt;1#gt;#quot;]<br>emit"]"#));
        let json: Value = serde_json::from_str(&drawing().json()).unwrap();
        assert_eq!(json["stages"][1], json!({ "name": "y", "kind": "concat", "instances": 2 }));
        assert_eq!(json["edges"][0]["from"], "x[t=\"<1>\"]");
    }
}
