//! A network as a graph: parts that compute their layers from the observations or from another part.
//!
//! Actor, critic and heads of an agent share one encoder, and so do the members of an ensemble; both are graphs of this
//! kind, and both backends ([`super::native`], [`super::torch`]) walk over them in the same way.

use std::ops::Range;

use super::Sequential;

/// The position of a part in its graph.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub struct NodeId(pub(super) usize);

/// The parts of a network; each comes after the one that it computes from.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Graph {
    pub(super) nodes: Vec<Node>,
}

/// A part of a network; it has at least one layer.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct Node {
    /// Where its input comes from; none: the observations.
    pub(super) source: Option<usize>,
    pub(super) layers: Sequential,
}

/// An output that is asked for: a part, and the rows of the batch that it sees.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Wanted {
    /// The part.
    pub node: NodeId,
    /// The rows; a part that others compute from sees all of them.
    pub rows: Range<usize>,
}

impl Graph {
    pub(super) fn push(&mut self, source: Option<NodeId>, layers: Sequential) -> NodeId {
        self.nodes.push(Node { source: source.map(|id| id.0), layers });
        NodeId(self.nodes.len() - 1)
    }

    /// The rows that each part has to compute so that the outputs asked for can be; none where it need not run.
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
