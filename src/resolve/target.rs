//! Selects the stages of a graph for a command: `table22`, `table*`, `evaluate[policy=beta, seed=1|2]`.

use std::collections::BTreeSet;

use petgraph::Direction;
use petgraph::graph::DiGraph;
use petgraph::visit::EdgeRef;

use super::graph::{Graph, Origin, StageIndex, StageInstance};
use super::pattern::{NoStage, Pattern};

/// The selection of stages.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Selection {
    /// Target stages, which are brought up to date with everything upstream; all stages if empty.
    pub targets: Vec<String>,
    /// Of the targets, only these stages and stages downstream of them.
    pub from: Vec<String>,
    /// Stages that run even if they are cached.
    pub force: Vec<String>,
    /// True: only the targets run; everything upstream must be cached.
    pub only: bool,
}

/// A part of a graph.
#[derive(Clone, Debug)]
pub struct Selected {
    /// The targets and everything upstream, on which their keys depend.
    pub graph: Graph,
    /// All stages, and the index of each in `graph`; `None` where all stages are selected.
    pub whole: Option<(Graph, Vec<Option<StageIndex>>)>,
    /// Stages of `graph` that run even if they are cached.
    pub forced: BTreeSet<StageIndex>,
    /// Stages of `graph` that must be cached, because they are not targets (`--only`).
    pub must_be_cached: BTreeSet<StageIndex>,
}

impl Selected {
    /// All stages.
    pub fn all(&self) -> &Graph {
        self.whole.as_ref().map_or(&self.graph, |(graph, _)| graph)
    }

    /// The index in `graph` of a stage of [`Selected::all`]; `None` where it is not selected.
    pub fn place(&self, stage: StageIndex) -> Option<StageIndex> {
        match &self.whole {
            Some((_, places)) => places.get(stage.index()).copied().flatten(),
            None => Some(stage),
        }
    }
}

impl Selection {
    /// True where all stages are selected and none is forced.
    pub fn is_all(&self) -> bool {
        *self == Self::default()
    }

    /// The selected part of `graph`.
    ///
    /// # Errors
    /// A pattern matches no stage, or no stage is selected.
    pub fn of(&self, graph: Graph) -> Result<Selected, NoStage> {
        let count = graph.stages.node_count();
        if count == 0 {
            return Err(NoStage {
                message: format!("no stage exists under profile `{}`: every `when` is false", graph.profile),
                hint: "choose another profile, or change the `when` of a stage".to_owned(),
            });
        }
        let mut goals = vec![self.targets.is_empty(); count];
        mark(&graph, &self.targets, &mut goals)?;
        if !self.from.is_empty() {
            let mut behind = vec![false; count];
            mark(&graph, &self.from, &mut behind)?;
            spread(&graph, &mut behind, Direction::Outgoing);
            goals.iter_mut().zip(behind).for_each(|(goal, behind)| *goal &= behind);
        }
        if !goals.contains(&true) {
            return Err(NoStage {
                message: "none of the target stages is downstream of `--from`".to_owned(),
                hint: "remove the targets or `--from`".to_owned(),
            });
        }
        let mut kept = goals.clone();
        spread(&graph, &mut kept, Direction::Incoming);
        let mut forced = vec![false; count];
        mark(&graph, &self.force, &mut forced)?;
        let (part, places) = if kept.contains(&false) {
            let (part, places) = restrict(&graph, &kept);
            (Some(part), places)
        } else {
            (None, graph.stages.node_indices().map(Some).collect())
        };
        let set = |marks: &dyn Fn(usize) -> bool| {
            let marked = (0..count).filter(|stage| marks(*stage));
            marked.filter_map(|stage| places[stage]).collect::<BTreeSet<_>>()
        };
        let forced = set(&|stage| forced[stage]);
        let must_be_cached = set(&|stage| self.only && !goals[stage]);
        if forced.is_empty() && !self.force.is_empty() {
            return Err(NoStage {
                message: "the stages of `--force` are not selected".to_owned(),
                hint: "add them to the targets, or run all stages".to_owned(),
            });
        }
        Ok(match part {
            Some(part) => Selected { graph: part, whole: Some((graph, places)), forced, must_be_cached },
            None => Selected { graph, whole: None, forced, must_be_cached },
        })
    }
}

/// Marks the stages that match the patterns.
fn mark(graph: &Graph, patterns: &[String], marks: &mut [bool]) -> Result<(), NoStage> {
    for text in patterns {
        for stage in Pattern::parse(text)?.stages(graph)? {
            marks[stage.index()] = true;
        }
    }
    Ok(())
}

/// Marks everything that can be reached from marked stages.
fn spread(graph: &Graph, marks: &mut [bool], direction: Direction) {
    let mut open: Vec<StageIndex> =
        graph.stages.node_indices().filter(|stage| marks[stage.index()]).collect();
    while let Some(stage) = open.pop() {
        for next in graph.stages.neighbors_directed(stage, direction) {
            if !std::mem::replace(&mut marks[next.index()], true) {
                open.push(next);
            }
        }
    }
}

/// The graph of the marked stages, in order. Everything that they read must be marked, too.
fn restrict(graph: &Graph, kept: &[bool]) -> (Graph, Vec<Option<StageIndex>>) {
    let mut places = vec![None; kept.len()];
    let mut stages: DiGraph<StageInstance, (), u32> = DiGraph::new();
    for stage in graph.stages.node_indices().filter(|stage| kept[stage.index()]) {
        places[stage.index()] = Some(stages.add_node(graph.stages[stage].clone()));
    }
    for stage in stages.node_weights_mut() {
        for source in stage.inputs.iter_mut().flat_map(|wire| &mut wire.sources) {
            if let Origin::Stage { stage, .. } = &mut source.from
                && let Some(place) = places[stage.index()]
            {
                *stage = place;
            }
        }
    }
    for edge in graph.stages.edge_references() {
        if let (Some(from), Some(to)) = (places[edge.source().index()], places[edge.target().index()]) {
            stages.add_edge(from, to, ());
        }
    }
    let part = Graph {
        pipeline: graph.pipeline.clone(),
        profile: graph.profile.clone(),
        left_out: graph.left_out.clone(),
        sweeps: graph.sweeps.clone(),
        stages,
    };
    (part, places)
}
