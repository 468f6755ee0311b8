//! The values that an axis has under any profile, to tell a misspelt value from one that the chosen profile leaves out.

use std::sync::Arc;

use super::axes::{Axes, Axis};
use super::choices::Layers;
use super::context::ResolveContext;
use super::globals;
use super::rules::{maps, one_or_more};
use super::scope::{Filler, Globals, Scope};
use crate::spec::model::Stage;
use crate::spec::problem::ProblemList;
use crate::spec::source::Sources;

/// The texts that `axis` of a stage, or with a path the field of its values, has: now, without a profile, or under any profile.
/// Those of now first.
pub(super) fn values(
    axis: &Axis,
    path: &[&str],
    stage: &Stage,
    context: &ResolveContext<'_>,
) -> Vec<Arc<str>> {
    let mut found: Vec<Arc<str>> = Vec::new();
    let mut add = |text: Arc<str>| {
        if !found.contains(&text) {
            found.push(text);
        }
    };
    axis.values().iter().filter_map(|value| value.text(path)).for_each(&mut add);
    let sources = Sources::of(&context.spec.sources);
    // What is wrong under another profile is reported there.
    let mut problems = ProblemList::default();
    let mut filler = Filler::new(&sources, &mut problems);
    for (globals, axes) in context.elsewhere.get_or_init(|| all(context)) {
        let scope = Scope { globals, axes: Vec::new(), all_axes: context.axis_places, place: "an axis" };
        let shared = axes.0.get(&axis.name).cloned().flatten();
        let own = stage.matrix.iter().find(|own| own.name.text == axis.name);
        let there = match own.and_then(|own| Some((&own.name, own.values.as_ref()?))) {
            Some((name, values)) => globals::axis(name, shared, &[values], &scope, &mut filler),
            None => shared,
        };
        there.iter().flat_map(Axis::values).filter_map(|value| value.text(path)).for_each(&mut add);
        if path.is_empty() {
            included(axis, stage, &scope, &mut filler).into_iter().for_each(&mut add);
        }
    }
    found
}

/// The values of an axis that `include` names.
fn included(axis: &Axis, stage: &Stage, scope: &Scope<'_>, filler: &mut Filler<'_>) -> Vec<Arc<str>> {
    let Some(node) = stage.rules.include.as_ref().and_then(|node| filler.fill(node, scope)) else {
        return Vec::new();
    };
    let maps = maps(&node, "include", filler).unwrap_or_default();
    let values = maps.into_iter().flatten().filter(|(key, _)| key.text == axis.name);
    values.flat_map(|(_, value)| one_or_more(value)).filter_map(|value| value.scalar_text()).collect()
}

/// Params and axes without `--set`: without a profile, then under each.
fn all(context: &ResolveContext<'_>) -> Vec<(Globals, Axes)> {
    let sources = Sources::of(&context.spec.sources);
    let profiles = std::iter::once(None).chain(context.spec.profiles.iter().map(Some));
    let under = profiles.map(|profile| {
        let mut problems = ProblemList::default();
        let mut filler = Filler::new(&sources, &mut problems);
        let layers = Layers::under(context.spec, profile);
        let globals = globals::globals(context.spec, &layers, context.axis_places, &mut filler);
        let scope =
            Scope { globals: &globals, axes: Vec::new(), all_axes: context.axis_places, place: "`axes`" };
        let axes = globals::axes(context.spec, &layers, &scope, &mut filler);
        (globals, axes)
    });
    under.collect()
}
