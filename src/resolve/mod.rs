//! From a [`Spec`] to a [`Graph`] of stage instances: profile, overrides, matrices, parameters, wiring, type check.
//! Pure: no I/O. All problems at once.
//!
//! `choices` parses profile and `--set` (`sweep` explains where several values do not work); `globals` and `axes` evaluate params and axes; `matrix` and `grid` expand matrices by
//! their `rules` (`when` checks its values against those that axes have `elsewhere`), and `expand` checks the parameters of each
//! instance; `items`, `select` and `wiring` connect instances, whose `labels` their readers check; `build` makes the graph.
//! `scope` resolves `$name`; `template` and `reference` parse texts with `$` and input references.

mod axes;
mod build;
mod choices;
mod context;
mod cycles;
mod elsewhere;
mod expand;
mod globals;
mod graph;
mod grid;
mod items;
mod labels;
mod matrix;
mod merge;
mod params;
mod pattern;
mod reference;
mod rules;
mod scope;
mod select;
mod sweep;
mod target;
mod template;
mod when;
mod wiring;

use std::cell::OnceCell;
use std::collections::{BTreeMap, BTreeSet, HashMap};
use std::sync::Arc;

pub use graph::{Graph, Origin, Source, StageIndex, StageInstance, Wire, file_name};
pub use pattern::{NoStage, Pattern};
pub use target::{Selected, Selection};

use dril_stage_api::Registry;

use crate::spec::source::{Sources, Span};
use crate::spec::{Diagnostics, Spec};
use choices::{Layers, Spread};
use context::ResolveContext;
use scope::{Filler, Scope};

/// The choices of the user: profile, overrides and environment.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Choices {
    /// The profile (`--profile`); `None` for the first one in the file.
    pub profile: Option<String>,
    /// Overrides (`--set`), as in `dril.total_timesteps=98304`. Later ones win.
    pub set: Vec<String>,
    /// The environment variables whose values are UTF-8. A stage that names one gets its value, and runs again when it changes.
    pub environment: BTreeMap<String, String>,
    /// Environment variables whose values are not UTF-8: a stage that names one is an error.
    pub not_text: BTreeSet<String>,
}

/// Resolves a pipeline file.
///
/// # Errors
/// All problems, each with its place, including those that [`crate::spec::parse`] found.
pub fn resolve(spec: &Spec, choices: &Choices, registry: &Registry) -> Result<Graph, Diagnostics> {
    let mut spread = Spread::new();
    loop {
        let mut sources = Sources::of(&spec.sources);
        let mut problems = spec.problems.clone();
        let layers = Layers::read(spec, choices, &spread, &mut sources, &mut problems);
        let mut filler = Filler::new(&sources, &mut problems);
        let graph = resolve_layers(spec, &layers, registry, choices, &mut filler);
        // Each iteration adds the axis of a sweep to another stage, so the loop ends.
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
        elsewhere: OnceCell::new(),
    };
    let stages = expand::expand(&context, filler);
    build::graph(&context, stages, filler)
}
