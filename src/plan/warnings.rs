//! Everything that a plan warns of, from the graph and the names of files alone: the warnings are the same before and after a run.

use std::collections::HashSet;
use std::path::Path;

use super::warning::Warning;
use super::{idle, pooled, undeclared};
use crate::resolve::Graph;

/// The warnings about the stages of `selected`, which is a part of `whole`: what is left out can show that an axis matters.
/// `base` is the folder of the pipeline file.
pub fn warnings(whole: &Graph, selected: &Graph, base: &Path) -> Vec<Warning> {
    let names: HashSet<&str> = selected.stages.node_weights().map(|stage| &*stage.name).collect();
    let is_shown = |name: &str| names.contains(name);
    let mut found = idle::warnings(whole, &is_shown);
    found.extend(pooled::warnings(selected, &is_shown));
    found.extend(undeclared::warnings(selected, base, &is_shown));
    found
}
