//! The graph as flat arrays: a topological order, and the readers of each stage. Derived from the wiring, so that the two always
//! agree.

use std::cmp::Reverse;
use std::collections::BinaryHeap;

use crate::resolve::{Graph, Origin, StageIndex};

/// Topological order and readers of a graph.
#[derive(Clone, Debug)]
pub struct Order {
    /// Topological order; of stages that could come next, the first in node order.
    pub topological: Vec<StageIndex>,
    /// For each stage, the number of different stages that feed it.
    pub feeders: Vec<u32>,
    starts: Vec<u32>,
    readers: Vec<StageIndex>,
}

impl Order {
    /// The order of `graph`; the error is a stage on a cycle.
    ///
    /// # Errors
    /// The graph has a cycle.
    pub fn of(graph: &Graph) -> Result<Self, StageIndex> {
        let count = graph.stages.node_count();
        let mut edges: Vec<(StageIndex, StageIndex)> = Vec::with_capacity(graph.stages.edge_count());
        for stage in graph.stages.node_indices() {
            edges.extend(feeding(graph, stage).map(|from| (from, stage)));
        }
        edges.sort_unstable();
        edges.dedup();
        let mut starts = vec![0_u32; count + 1];
        let mut feeders = vec![0_u32; count];
        for (from, to) in &edges {
            starts[from.index() + 1] += 1;
            feeders[to.index()] += 1;
        }
        for index in 0..count {
            starts[index + 1] += starts[index];
        }
        let readers = edges.into_iter().map(|(_, to)| to).collect();
        let mut order = Self { topological: Vec::with_capacity(count), feeders, starts, readers };
        order.sort()?;
        Ok(order)
    }

    /// The stages that read an output of `stage`, in node order, each once.
    pub fn readers(&self, stage: StageIndex) -> &[StageIndex] {
        let (from, to) = (self.starts[stage.index()], self.starts[stage.index() + 1]);
        &self.readers[from as usize..to as usize]
    }

    /// For each stage, the cost of the longest path from it to the end, including itself.
    pub fn costs_to_the_end(&self, graph: &Graph) -> Vec<f64> {
        let mut costs = vec![0.0_f64; self.feeders.len()];
        for &stage in self.topological.iter().rev() {
            let behind = self.readers(stage).iter().map(|reader| costs[reader.index()]).fold(0.0, f64::max);
            costs[stage.index()] = behind + self.own_cost(graph, stage);
        }
        costs
    }

    /// The cost of a stage itself, not negative.
    pub fn own_cost(&self, graph: &Graph, stage: StageIndex) -> f64 {
        let own = graph.stages[stage].needs.cost;
        if own.is_finite() { own.max(0.0) } else { 0.0 }
    }

    fn sort(&mut self) -> Result<(), StageIndex> {
        let mut left = self.feeders.clone();
        let free = (0_u32..).zip(&left).filter(|(_, left)| **left == 0);
        let mut next: BinaryHeap<Reverse<StageIndex>> =
            free.map(|(index, _)| Reverse(StageIndex::from(index))).collect();
        while let Some(Reverse(stage)) = next.pop() {
            self.topological.push(stage);
            for &reader in self.readers(stage) {
                left[reader.index()] -= 1;
                if left[reader.index()] == 0 {
                    next.push(Reverse(reader));
                }
            }
        }
        match left.iter().position(|left| *left > 0) {
            Some(index) => Err(StageIndex::new(index)),
            None => Ok(()),
        }
    }
}

/// The stages that feed `stage`, once for each artifact.
pub fn feeding(graph: &Graph, stage: StageIndex) -> impl Iterator<Item = StageIndex> + '_ {
    let sources = graph.stages[stage].inputs.iter().flat_map(|wire| &wire.sources);
    sources.filter_map(|source| match source.from {
        Origin::Stage { stage, .. } => Some(stage),
        Origin::File { .. } => None,
    })
}
