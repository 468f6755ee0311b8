//! Short names for groups of stage instances: `dril × 8`, `clone[policy=beta] × 4`.

use std::collections::{BTreeMap, BTreeSet};

use crate::resolve::{Graph, StageIndex};

/// The word for `count` instances of a stage, which share these coordinates (`policy=beta`).
pub(super) fn word(stage: &str, shared: &[String], count: usize) -> String {
    let shared = if shared.is_empty() { String::new() } else { format!("[{}]", shared.join(", ")) };
    format!("{stage}{shared} × {count}")
}

/// Names groups of stage instances.
pub(super) struct Names<'g> {
    graph: &'g Graph,
    instances: BTreeMap<&'g str, usize>,
}

impl<'g> Names<'g> {
    /// For the stages of this graph.
    pub fn new(graph: &'g Graph) -> Self {
        let mut instances = BTreeMap::new();
        for stage in graph.stages.node_weights() {
            *instances.entry(&*stage.name).or_insert(0) += 1;
        }
        Self { graph, instances }
    }

    /// One word for these instances of one stage: its id where it is one, the stage's name where they are all, else the
    /// coordinates that they share.
    pub fn group(&self, group: &[StageIndex]) -> String {
        let Some(first) = group.first().and_then(|index| self.graph.stages.node_weight(*index)) else {
            return String::new();
        };
        if group.len() == 1 {
            return first.id.to_string();
        }
        let all = self.instances.get(&*first.name) == Some(&group.len());
        let members = || group.iter().filter_map(|index| self.graph.stages.node_weight(*index));
        let shared: Vec<String> = first
            .coordinates
            .iter()
            .filter(|coordinate| !all && members().all(|stage| stage.coordinates.contains(coordinate)))
            .map(|(axis, value)| format!("{axis}={value}"))
            .collect();
        word(&first.name, &shared, group.len())
    }

    /// True where both name the same stages, whichever instances.
    pub fn same_stages(&self, one: &[StageIndex], other: &[StageIndex]) -> bool {
        one == other || self.stages(one) == self.stages(other)
    }

    fn stages(&self, instances: &[StageIndex]) -> BTreeSet<&'g str> {
        instances
            .iter()
            .filter_map(|index| self.graph.stages.node_weight(*index))
            .map(|stage| &*stage.name)
            .collect()
    }

    /// Words for instances of any stages, one a stage, in the order of the file; at most `limit` of them.
    pub fn groups(&self, stages: &[StageIndex], limit: usize) -> String {
        let mut groups: Vec<(&str, Vec<StageIndex>)> = Vec::new();
        for index in stages {
            let Some(stage) = self.graph.stages.node_weight(*index) else { continue };
            match groups.iter_mut().find(|(name, _)| *name == &*stage.name) {
                Some((_, group)) => group.push(*index),
                None => groups.push((&stage.name, vec![*index])),
            }
        }
        let shown: Vec<String> = groups.iter().take(limit).map(|(_, group)| self.group(group)).collect();
        match groups.len().saturating_sub(limit) {
            0 => shown.join(", "),
            more => format!("{} and {more} more", shown.join(", ")),
        }
    }
}
