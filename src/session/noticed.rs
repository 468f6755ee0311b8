//! What a plan warns of, with all that it depends on beside the pipeline: a run in which nothing changed repeats it without
//! reading the pipeline.

use std::collections::{BTreeMap, BTreeSet};
use std::path::{Path, PathBuf};

use serde::{Deserialize, Serialize};

use crate::plan::{self, Warning};
use crate::resolve::Graph;

/// Warnings, and what they depend on.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub(super) struct Noticed {
    /// The warnings of the plan.
    pub warnings: Vec<Warning>,
    /// The resources that stages ask for: `--resources` should name no other.
    pub resources: BTreeSet<String>,
    /// The paths that commands name, and whether there is a file.
    named: BTreeMap<PathBuf, bool>,
}

impl Noticed {
    /// About the stages of `selected`, which is a part of `whole`.
    pub fn of(whole: &Graph, selected: &Graph, base: &Path) -> Self {
        let resources = whole.stages.node_weights().flat_map(|stage| stage.resources.keys());
        Self {
            named: plan::named_files(selected, base),
            warnings: plan::warnings(whole, selected, base),
            resources: resources.cloned().collect(),
        }
    }

    /// True where the same pipeline gives the same warnings.
    pub fn still_holds(&self) -> bool {
        self.named.iter().all(|(path, was_file)| plan::is_file(path) == *was_file)
    }
}
