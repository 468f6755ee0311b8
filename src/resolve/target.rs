//! Which stages of a graph a command is about: `table22`, `table*`, `evaluate[policy=beta, seed=1|2]`.

use std::collections::BTreeSet;

use petgraph::Direction;
use petgraph::graph::DiGraph;
use petgraph::visit::EdgeRef;

use super::graph::{From, Graph, StageIndex, StageInstance};
use super::pattern::{NoStage, Pattern};

/// What was asked for.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Selection {
    /// Stages to bring up to date, with all that they need; without any, all stages.
    pub targets: Vec<String>,
    /// Stages with all that depends on them; of the targets, those that do.
    pub from: Vec<String>,
    /// Stages to run again although they are cached.
    pub force: Vec<String>,
    /// True: nothing but these stages; what they need must be there.
    pub only: bool,
}

/// A part of a graph.
#[derive(Clone, Debug)]
pub struct Selected {
    /// The stages that were asked for and, since their keys come from there, all that they need.
    pub graph: Graph,
    /// All stages, and the place of each in `graph`; `None` where nothing was left out.
    pub whole: Option<(Graph, Vec<Option<StageIndex>>)>,
    /// Stages of `graph` that are to run although they are cached.
    pub forced: BTreeSet<StageIndex>,
    /// Stages of `graph` that must be cached, since only others were asked for.
    pub must_be_cached: BTreeSet<StageIndex>,
}

impl Selected {
    /// All stages.
    pub fn all(&self) -> &Graph {
        self.whole.as_ref().map_or(&self.graph, |(graph, _)| graph)
    }

    /// The place in `graph` of a stage of [`Selected::all`]; `None` where it is no part of it.
    pub fn place(&self, stage: StageIndex) -> Option<StageIndex> {
        match &self.whole {
            Some((_, places)) => places.get(stage.index()).copied().flatten(),
            None => Some(stage),
        }
    }
}

impl Selection {
    /// True where nothing is left out and nothing forced.
    pub fn is_all(&self) -> bool {
        *self == Self::default()
    }

    /// The part of `graph` that is meant.
    ///
    /// # Errors
    /// A pattern means no stage, or nothing is left.
    pub fn of(&self, graph: Graph) -> Result<Selected, NoStage> {
        let count = graph.stages.node_count();
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
                message: "none of the stages that were asked for depends on those after `--from`".to_owned(),
                hint: "leave one of the two out".to_owned(),
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
                message: "the stages after `--force` are none of those that were asked for".to_owned(),
                hint: "name them as targets too, or leave the targets out".to_owned(),
            });
        }
        Ok(match part {
            Some(part) => Selected { graph: part, whole: Some((graph, places)), forced, must_be_cached },
            None => Selected { graph, whole: None, forced, must_be_cached },
        })
    }
}

/// Marks the stages that the patterns mean.
fn mark(graph: &Graph, patterns: &[String], marks: &mut [bool]) -> Result<(), NoStage> {
    for text in patterns {
        for stage in Pattern::parse(text)?.stages(graph)? {
            marks[stage.index()] = true;
        }
    }
    Ok(())
}

/// Marks all that can be reached from what is marked.
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

/// The graph of the stages that are marked, in their order. Whatever they read must be marked too.
fn restrict(graph: &Graph, kept: &[bool]) -> (Graph, Vec<Option<StageIndex>>) {
    let mut places = vec![None; kept.len()];
    let mut stages: DiGraph<StageInstance, (), u32> = DiGraph::new();
    for stage in graph.stages.node_indices().filter(|stage| kept[stage.index()]) {
        places[stage.index()] = Some(stages.add_node(graph.stages[stage].clone()));
    }
    for stage in stages.node_weights_mut() {
        for source in stage.inputs.iter_mut().flat_map(|wire| &mut wire.sources) {
            if let From::Stage { stage, .. } = &mut source.from
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
    (Graph { pipeline: graph.pipeline.clone(), profile: graph.profile.clone(), stages }, places)
}
