//! A network as a graph of nodes, each a sequence of layers applied to the observations or to another node's output.
//!
//! Actor, critic and heads of a policy share one encoder, and so do the members of an ensemble; both are such graphs, and
//! both backends ([`super::native`], [`super::torch`]) evaluate them in the same way.

use std::ops::Range;

use super::layers::Sequential;

/// Index of a node in its graph.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub struct NodeId(pub(super) usize);

/// The nodes of a network; each comes after its source.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Graph {
    pub(super) nodes: Vec<Node>,
}

/// A node of a network; it has at least one layer.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct Node {
    /// The node that its input comes from; none: the observations.
    pub(super) source: Option<usize>,
    pub(super) layers: Sequential,
}

/// A requested output: a node, and the rows of the batch to compute it for.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Wanted {
    /// The node.
    pub node: NodeId,
    /// The rows; a source of other nodes is computed for all rows.
    pub rows: Range<usize>,
}

impl Graph {
    pub(super) fn push(&mut self, source: Option<NodeId>, layers: Sequential) -> NodeId {
        self.nodes.push(Node { source: source.map(|id| id.0), layers });
        NodeId(self.nodes.len() - 1)
    }

    /// The rows for which each node has to be computed, to get the requested outputs; none if it is not needed.
    pub(super) fn needed(&self, wanted: &[Wanted], rows: usize) -> Vec<Option<Range<usize>>> {
        let mut needed = vec![None; self.nodes.len()];
        for Wanted { node, rows } in wanted {
            needed[node.0] = Some(rows.clone());
        }
        for index in (0..self.nodes.len()).rev() {
            if let (Some(_), Some(source)) = (&needed[index], self.nodes[index].source) {
                needed[source] = Some(0..rows);
            }
        }
        needed
    }
}
