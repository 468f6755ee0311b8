//! What resolving needs everywhere: the file, the choices, the kinds, and the values of params and axes.

use std::cell::OnceCell;
use std::collections::HashMap;
use std::sync::Arc;

use dril_stage_api::Registry;

use super::Choices;
use super::axes::{Axes, AxisValue};
use super::choices::Layers;
use super::scope::{Globals, Scope};
use crate::spec::Spec;
use crate::spec::source::Span;

/// More stage instances than this are refused: most likely a mistake in a matrix.
pub(super) const MAX_INSTANCES: usize = 100_000;

/// Shared by all steps of resolving.
pub(super) struct ResolveContext<'a> {
    pub spec: &'a Spec,
    pub layers: &'a Layers<'a>,
    pub registry: &'a Registry,
    pub globals: &'a Globals,
    pub axes: &'a Axes,
    pub axis_places: &'a HashMap<Arc<str>, Span>,
    /// The pipeline's seed; `None` where it is broken, which was reported.
    pub seed: Option<u64>,
    /// The choices of the command line, with the environment of the run.
    pub choices: &'a Choices,
    /// Params and axes under all profiles; made when they are first needed.
    pub elsewhere: OnceCell<Vec<(Globals, Axes)>>,
}

impl<'a> ResolveContext<'a> {
    /// The names that are visible at an instance of a stage.
    pub fn scope(&self, axes: Vec<(&'a str, &'a AxisValue)>, place: &'a str) -> Scope<'a> {
        Scope { globals: self.globals, axes, all_axes: self.axis_places, place }
    }
}
