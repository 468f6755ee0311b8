//! Everything that a plan warns of, from the graph alone: the warnings are the same before and after a run.

use std::collections::HashSet;

use super::warning::Warning;
use super::{idle, pooled};
use crate::resolve::Graph;

/// The warnings about the stages of `selected`, which is a part of `whole`: what is left out can show that an axis matters.
pub fn warnings(whole: &Graph, selected: &Graph) -> Vec<Warning> {
    let names: HashSet<&str> = selected.stages.node_weights().map(|stage| &*stage.name).collect();
    let is_shown = |name: &str| names.contains(name);
    let mut found = idle::warnings(whole, &is_shown);
    found.extend(pooled::warnings(selected, &is_shown));
    found
}
