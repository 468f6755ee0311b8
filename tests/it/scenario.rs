//! A graph of fakes as plain data: tests build it in code, and hand it as a file to another process that runs it.
#![allow(dead_code, clippy::unwrap_used, clippy::panic, clippy::print_stdout, clippy::print_stderr)]

use std::collections::BTreeMap;
use std::path::PathBuf;

use dril_pipe::resolve::{Graph, Origin, Source, StageInstance, Wire};
use dril_stage_api::{Labels, Seed};
use petgraph::graph::{DiGraph, NodeIndex};
use serde::{Deserialize, Serialize};
use serde_json::Value;

use crate::fakes;

/// A run: where, and of what.
#[derive(Clone, Debug, Default, Serialize, Deserialize)]
pub struct Scenario {
    /// The store's folder.
    pub store: PathBuf,
    /// The folder that files from outside are relative to.
    pub base: PathBuf,
    /// Threads to use.
    pub threads: usize,
    /// Seconds between checkpoints.
    pub checkpoint_seconds: f64,
    /// The stages; a stage reads only from stages before it.
    pub stages: Vec<StageLine>,
}

/// A stage of a scenario.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub struct StageLine {
    /// Its name, also its id.
    pub name: String,
    /// One of the fakes.
    pub kind: String,
    /// Its parameters, before defaults.
    pub with: Value,
    /// Its seed, where the kind has one.
    pub seed: u64,
    /// What is wired to each input.
    pub inputs: BTreeMap<String, Vec<Part>>,
}

/// An artifact at an input.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub enum Part {
    /// The stage's first output.
    Stage(String),
    /// A file from outside.
    File(String),
}

impl StageLine {
    /// A stage with nothing wired to it and seed 1.
    pub fn new(name: &str, kind: &str, with: Value) -> Self {
        Self { name: name.into(), kind: kind.into(), with, seed: 1, inputs: BTreeMap::new() }
    }

    /// Wires stages to an input.
    pub fn reads(mut self, port: &str, stages: &[&str]) -> Self {
        self.inputs
            .entry(port.into())
            .or_default()
            .extend(stages.iter().map(|name| Part::Stage((*name).into())));
        self
    }

    /// Wires a file from outside to an input.
    pub fn reads_file(mut self, port: &str, path: &str) -> Self {
        self.inputs.entry(port.into()).or_default().push(Part::File(path.into()));
        self
    }
}

/// The graph of these stages, as resolving a pipeline file would give it.
pub fn graph(stages: &[StageLine]) -> Graph {
    let registry = fakes::registry();
    let mut graph = DiGraph::new();
    let mut index: BTreeMap<&str, NodeIndex<u32>> = BTreeMap::new();
    for line in stages {
        let kind = *registry.get(&line.kind).unwrap_or_else(|| panic!("no fake `{}`", line.kind));
        let params =
            kind.normalize(&line.with).unwrap_or_else(|problems| panic!("{}: {problems:?}", line.name));
        let node = graph.add_node(StageInstance {
            name: line.name.as_str().into(),
            id: line.name.as_str().into(),
            coordinates: Vec::new(),
            kind,
            seed: kind.seeded().then_some(Seed(line.seed)),
            needs: kind.needs(&params).unwrap(),
            limits: Default::default(),
            resources: Default::default(),
            ports: kind.ports(&params).unwrap(),
            inputs: Vec::new(),
            params,
        });
        index.insert(&line.name, node);
        let wires = wires(line, &graph, &index);
        for source in wires.iter().flat_map(|wire| &wire.sources) {
            if let Origin::Stage { stage, .. } = source.from
                && !graph.contains_edge(stage, node)
            {
                graph.add_edge(stage, node, ());
            }
        }
        graph[node].inputs = wires;
    }
    Graph {
        pipeline: "scenario".into(),
        profile: "default".into(),
        left_out: Vec::new(),
        sweeps: Vec::new(),
        stages: graph,
    }
}

fn wires(
    line: &StageLine,
    graph: &DiGraph<StageInstance, (), u32>,
    index: &BTreeMap<&str, NodeIndex<u32>>,
) -> Vec<Wire> {
    let ports = &graph[index[line.name.as_str()]].ports;
    let mut wires = Vec::new();
    for port in &ports.inputs {
        let Some(parts) = line.inputs.get(port.name) else { continue };
        let many = port.arity == dril_stage_api::Arity::Many;
        let sources = parts.iter().map(|part| {
            let (from, name) = match part {
                Part::Stage(name) => {
                    let stage = index[name.as_str()];
                    (Origin::Stage { stage, output: graph[stage].ports.outputs[0].name }, name)
                }
                Part::File(path) => (
                    Origin::File {
                        path: path.clone(),
                        place: "scenario:1:1".into(),
                        folder: false,
                        blake3: None,
                        exclude: Vec::new(),
                        key: path.clone(),
                    },
                    path,
                ),
            };
            let labels = if many { Labels::from([("name".to_owned(), name.clone())]) } else { Labels::new() };
            Source { from, labels }
        });
        wires.push(Wire { port: port.name, many, sources: sources.collect() });
    }
    wires
}
