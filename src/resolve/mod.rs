//! From a [`Spec`] to a [`Graph`] of stage instances: profile, overrides, matrices, parameters, wiring, type check.
//! Pure: no I/O. All problems at once.

mod graph;

pub use graph::{From, Graph, Source, StageIndex, StageInstance, Wire};

use dril_stage_api::Registry;
use petgraph::graph::DiGraph;

use crate::spec::{Diagnostics, Spec};

/// What the user chose on the command line.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Choices {
    /// `--profile`; without it, the first profile of the file.
    pub profile: Option<String>,
    /// `--set` arguments as given: `dril.total_steps=100000`. Later ones win.
    pub set: Vec<String>,
}

/// Resolves a pipeline file.
///
/// # Errors
/// All that is wrong with it, each with its place.
pub fn resolve(spec: &Spec, choices: &Choices, registry: &Registry) -> Result<Graph, Diagnostics> {
    let _ = (spec, choices, registry);
    Ok(Graph { pipeline: String::new(), profile: String::new(), stages: DiGraph::new() })
}
