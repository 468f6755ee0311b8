//! Builds the graph: instances as nodes, wires as edges. Checks that there is no cycle and that no two results share a file name.

use std::collections::HashMap;

use petgraph::graph::DiGraph;

use super::context::ResolveContext;
use super::cycles;
use super::expand::{ENOUGH, Expanded, Instance};
use super::graph::{self, Graph, Origin, StageIndex, StageInstance};
use super::scope::Filler;
use super::wiring::{Wirer, Wires};
use crate::spec::problem::Problem;
use crate::spec::source::Span;

/// Builds the graph; `None` where a problem was reported.
pub(super) fn graph(
    context: &ResolveContext<'_>,
    stages: Vec<Expanded<'_>>,
    filler: &mut Filler<'_>,
) -> Option<Graph> {
    let wires = connect(context, &stages, filler);
    report_cycles(&stages, &wires, filler);
    report_shared_files(&stages, filler);
    report_unexpanded(&stages, filler);
    if !filler.problems.is_empty() {
        return None;
    }
    let empty = stages.iter().filter(|stage| stage.instances.is_empty());
    let left_out = empty.map(|stage| stage.stage.name.text.clone()).collect();
    let mut graph = DiGraph::with_capacity(wires.len(), wires.len());
    let mut wires = wires.into_iter();
    for mut stage in stages {
        for (number, instance) in std::mem::take(&mut stage.instances).into_iter().enumerate() {
            graph.add_node(node(&stage, number, instance?, wires.next()?)?);
        }
    }
    add_edges(&mut graph);
    let globals = context.globals;
    Some(Graph {
        pipeline: globals.pipeline.to_string(),
        profile: globals.profile.to_string(),
        left_out,
        sweeps: context.layers.swept(),
        stages: graph,
    })
}

/// A safety net: without instances a stage would vanish, and its readers would run on less than the file says.
fn report_unexpanded(stages: &[Expanded<'_>], filler: &mut Filler<'_>) {
    if let Some(stage) = stages.iter().find(|stage| stage.grid.is_none())
        && filler.problems.is_empty()
    {
        filler.problems.add(|| {
            let message =
                format!("the matrix of stage `{}` was not expanded, for no known reason", stage.name());
            Problem::new(stage.stage.name.span, message)
                .hint("this is an error of dril-pipe: please report it")
        });
    }
}

/// The wires of every instance, by its number in the graph.
fn connect(context: &ResolveContext<'_>, stages: &[Expanded<'_>], filler: &mut Filler<'_>) -> Vec<Wires> {
    let mut wirer = Wirer::new(context, stages, filler);
    let mut wires = Vec::new();
    for stage in stages {
        let before = wirer.filler.problems.reports();
        for (number, instance) in stage.instances.iter().enumerate() {
            let reports = wirer.filler.problems.reports();
            let enough = reports > before + ENOUGH || wirer.filler.problems.is_full();
            let instance = instance.as_ref().filter(|_| !enough);
            let connected = instance.map(|instance| wirer.connect(stage, number, instance));
            wires.push(connected.unwrap_or_default());
        }
        if stage.instances.iter().all(Option::is_none) {
            wirer.look_over(stage);
        }
    }
    wires
}

fn node(stage: &Expanded<'_>, number: usize, instance: Instance, wires: Wires) -> Option<StageInstance> {
    let coordinates = stage.coordinates(number);
    Some(StageInstance {
        name: stage.stage.name.text.clone(),
        id: stage.id(number).into(),
        coordinates: coordinates
            .iter()
            .map(|(axis, value)| ((*axis).to_owned(), value.label.to_string()))
            .collect(),
        kind: stage.kind?,
        params: instance.params,
        seed: instance.seed,
        needs: instance.needs,
        limits: stage.stage.limits,
        resources: stage.stage.resources.clone(),
        ports: instance.ports,
        inputs: wires.into_iter().map(|(wire, _)| wire).collect(),
    })
}

fn add_edges(graph: &mut DiGraph<StageInstance, (), u32>) {
    for consumer in graph.node_indices() {
        let wires = graph[consumer].inputs.iter();
        let mut producers: Vec<StageIndex> =
            wires.flat_map(|wire| &wire.sources).filter_map(producer).collect();
        producers.sort_unstable();
        producers.dedup();
        for producer in producers {
            graph.add_edge(producer, consumer, ());
        }
    }
}

fn producer(source: &super::Source) -> Option<StageIndex> {
    match &source.from {
        Origin::Stage { stage, .. } => Some(*stage),
        Origin::File { .. } => None,
    }
}

fn report_cycles(stages: &[Expanded<'_>], wires: &[Wires], filler: &mut Filler<'_>) {
    let sources = |wires: &Wires| {
        let sources = wires.iter().flat_map(|(wire, _)| &wire.sources);
        sources.filter_map(producer).map(StageIndex::index).collect()
    };
    let dependencies: Vec<Vec<usize>> = wires.iter().map(sources).collect();
    let found = cycles::order(&dependencies);
    for mut cycle in found.cycles {
        // In the direction of data flow, starting at the first stage in the file: so parallel cycles of a matrix look the same.
        cycle.reverse();
        let first = cycle.iter().enumerate().min_by_key(|(_, number)| **number).map_or(0, |(at, _)| at);
        cycle.rotate_left(first);
        filler.problems.add(|| cycle_problem(&cycle, stages, wires));
    }
}

fn cycle_problem(cycle: &[usize], stages: &[Expanded<'_>], wires: &[Wires]) -> Problem {
    let stage_of = |number: usize| stages.partition_point(|stage| stage.first <= number) - 1;
    let of = |number: usize| &stages[stage_of(number)];
    let mut distinct: Vec<usize> = cycle.iter().map(|number| stage_of(*number)).collect();
    distinct.sort_unstable();
    distinct.dedup();
    let name = |number: usize| {
        let stage = of(number);
        if distinct.len() == cycle.len() { stage.name().to_owned() } else { stage.id(number - stage.first) }
    };
    let path: Vec<String> = cycle.iter().chain(cycle.first()).map(|number| name(*number)).collect();
    let step = |at: usize| {
        let (from, to) = (cycle[at], cycle[(at + 1) % cycle.len()]);
        (wire_place(from, to, wires, of(to)), format!("`{}` reads `{}`", name(to), name(from)))
    };
    let (at, label) = step(0);
    let first = Problem::new(at, format!("stages depend on each other in a cycle: `{}`", path.join(" -> ")))
        .label(label)
        .hint("an arrow points from a stage to one that reads it; remove one of these inputs");
    (1..cycle.len().min(8)).map(step).fold(first, |problem, (at, label)| problem.related(at, label))
}

fn wire_place(from: usize, to: usize, wires: &[Wires], stage: &Expanded<'_>) -> Span {
    let wire = wires[to]
        .iter()
        .find(|(wire, _)| wire.sources.iter().filter_map(producer).any(|producer| producer.index() == from));
    wire.map_or(stage.stage.name.span, |(_, at)| *at)
}

/// Results are copied to one folder, so no two may have the same file name.
fn report_shared_files(stages: &[Expanded<'_>], filler: &mut Filler<'_>) {
    let mut taken: HashMap<String, (usize, usize)> = HashMap::new();
    for (at, stage) in stages.iter().enumerate() {
        for (number, instance) in stage.instances.iter().enumerate() {
            let Some(instance) = instance else { continue };
            let labels = stage.coordinates(number);
            let stem = graph::file_stem(stage.name(), labels.iter().map(|(_, value)| &*value.label));
            let mut shared = None;
            for (_, name) in graph::result_files(&stem, &instance.ports.outputs) {
                let earlier = taken.insert(name.clone(), (at, number));
                shared = shared.or(earlier.map(|earlier| (earlier, name)));
            }
            let Some(((other, earlier), name)) = shared else { continue };
            let other = &stages[other];
            filler.problems.add(|| {
                let message = format!(
                    "the results of `{}` and `{}` would have the same file name `{name}`",
                    other.id(earlier),
                    stage.id(number)
                );
                Problem::new(stage.stage.name.span, message)
                    .maybe_related(Some(other.stage.name.span), "the other")
                    .hint("rename the stage, the output or the value of the axis")
            });
        }
    }
}
