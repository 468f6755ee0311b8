//! From a [`Spec`] to a [`Graph`] of stage instances: profile, overrides, matrices, parameters, wiring, type check.
//! Pure: no I/O. All problems at once.
//!
//! `choices` reads profile and `--set`; `globals` and `axes` give params and axes their values; `matrix` and `grid`
//! multiply matrices out, and `expand` has each instance's parameters checked; `items`, `select` and `wiring` connect
//! instances; `build` makes the graph.
//! `scope` knows what `$name` means where, `template` and `reference` take its text and that of a wiring apart.

mod axes;
mod build;
mod choices;
mod context;
mod cycles;
mod expand;
mod globals;
mod graph;
mod grid;
mod items;
mod matrix;
mod merge;
mod params;
mod pattern;
mod reference;
mod scope;
mod select;
mod target;
mod template;
mod wiring;

use std::collections::{BTreeMap, BTreeSet, HashMap};
use std::sync::Arc;

pub use graph::{From, Graph, Source, StageIndex, StageInstance, Wire, file_name};
pub use pattern::{NoStage, Pattern};
pub use target::{Selected, Selection};

use dril_stage_api::Registry;

use crate::spec::source::{Sources, Span};
use crate::spec::{Diagnostics, Spec};
use choices::{Layers, Spread};
use context::ResolveContext;
use scope::{Filler, Scope};

/// What the user chose on the command line.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Choices {
    /// `--profile`; without it, the first profile of the file.
    pub profile: Option<String>,
    /// `--set` arguments as given: `dril.total_timesteps=98304`. Later ones win.
    pub set: Vec<String>,
    /// The environment of the run, as far as it is text: stages that name a variable are given its value, and run anew
    /// when it changes.
    pub environment: BTreeMap<String, String>,
    /// Variables that are set, but to no text (they are not UTF-8): a stage that names one cannot be given its value.
    pub not_text: BTreeSet<String>,
}

/// Resolves a pipeline file.
///
/// # Errors
/// All that is wrong with it, each with its place: also what [`crate::spec::parse`] found.
pub fn resolve(spec: &Spec, choices: &Choices, registry: &Registry) -> Result<Graph, Diagnostics> {
    let mut spread = Spread::new();
    loop {
        let mut sources = Sources::of(&spec.sources);
        let mut problems = spec.problems.clone();
        let layers = Layers::read(spec, choices, &spread, &mut sources, &mut problems);
        let mut filler = Filler::new(&sources, &mut problems);
        let graph = resolve_layers(spec, &layers, registry, choices, &mut filler);
        // Each time round one more stage has the axis of a sweep, so there is an end.
        let before = spread.len();
        spread.append(&mut filler.spread);
        if spread.len() > before {
            continue;
        }
        return match graph {
            Some(graph) if problems.is_empty() => Ok(graph),
            _ => Err(problems.into_diagnostics(&sources)),
        };
    }
}

/// `None` only where a problem was reported.
fn resolve_layers(
    spec: &Spec,
    layers: &Layers<'_>,
    registry: &Registry,
    choices: &Choices,
    filler: &mut Filler<'_>,
) -> Option<Graph> {
    let axis_places: HashMap<Arc<str>, Span> =
        spec.base.axes.iter().map(|(key, _)| (key.text.clone(), key.span)).collect();
    let globals = globals::globals(spec, layers, &axis_places, filler);
    let scope = |place| Scope { globals: &globals, axes: Vec::new(), all_axes: &axis_places, place };
    let axes = globals::axes(spec, layers, &scope("`axes`"), filler);
    let seed = match layers.seeds().last() {
        Some(node) => globals::seed(node, &scope("the pipeline"), filler),
        None => Some(0),
    };
    let context = ResolveContext {
        spec,
        layers,
        registry,
        globals: &globals,
        axes: &axes,
        axis_places: &axis_places,
        seed,
        choices,
    };
    let stages = expand::expand(&context, filler);
    build::graph(&context, stages, filler)
}
