//! Pipeline-wide values: params, axes and the seed.

use std::collections::HashMap;
use std::sync::Arc;

use super::axes::{self, Axes, Axis};
use super::choices::Layers;
use super::cycles;
use super::merge::{effective, merge};
use super::scope::{Filler, Globals, Scope};
use super::template::{self, Lone, Piece, Template};
use crate::spec::Spec;
use crate::spec::node::{Key, Node, Value};
use crate::spec::problem::Problem;
use crate::spec::source::Span;

/// Evaluates the params, each after those that it refers to.
pub(super) fn globals(
    spec: &Spec,
    layers: &Layers<'_>,
    axes: &HashMap<Arc<str>, Span>,
    filler: &mut Filler<'_>,
) -> Globals {
    let pipeline = spec.pipeline.as_str().into();
    let mut globals = Globals { pipeline, profile: layers.profile.clone(), params: HashMap::new() };
    let names: Vec<&Key> = spec.base.params.iter().map(|(key, _)| key).collect();
    let index: HashMap<&str, usize> = names.iter().enumerate().map(|(at, key)| (&*key.text, at)).collect();
    let values: Vec<Vec<&Node>> = names.iter().map(|key| effective(&layers.param(&key.text))).collect();
    let uses: Vec<Vec<(usize, Span)>> = values.iter().map(|layers| references(layers, &index)).collect();
    let needs: Vec<Vec<usize>> = uses.iter().map(|uses| uses.iter().map(|(at, _)| *at).collect()).collect();
    let order = cycles::order(&needs);
    for cycle in &order.cycles {
        filler.problems.add(|| param_cycle(cycle, &names, &uses));
    }
    for key in &names {
        // Invalid until evaluated: params on a cycle, or depending on one, stay invalid.
        globals.params.insert(key.text.clone(), None);
    }
    for at in order.sorted {
        let scope = Scope { globals: &globals, axes: Vec::new(), all_axes: axes, place: "`params`" };
        let value = layered(&values[at], &scope, filler);
        globals.params.insert(names[at].text.clone(), value);
    }
    globals
}

/// Evaluates each layer and merges it over those below. All layers are evaluated, so that all problems are found.
pub(super) fn layered(layers: &[&Node], scope: &Scope<'_>, filler: &mut Filler<'_>) -> Option<Node> {
    let filled: Vec<Option<Node>> = layers.iter().map(|node| filler.fill(node, scope)).collect();
    let filled: Option<Vec<Node>> = filled.into_iter().collect();
    filled?.into_iter().reduce(merge)
}

/// The params that these values refer to, with the place of each reference.
fn references(layers: &[&Node], params: &HashMap<&str, usize>) -> Vec<(usize, Span)> {
    let mut found = Vec::new();
    let mut open: Vec<&Node> = layers.to_vec();
    while let Some(node) = open.pop() {
        match &node.value {
            Value::List(items) => open.extend(items),
            Value::Map(entries) => open.extend(entries.iter().map(|(_, node)| node)),
            Value::Text(text) => {
                let paths = match template::parse(text, Lone::Refuse) {
                    Ok(Template::Exact(path)) => vec![path],
                    Ok(Template::Mixed(pieces)) => pieces
                        .into_iter()
                        .filter_map(|piece| if let Piece::Path(path) = piece { Some(path) } else { None })
                        .collect(),
                    Ok(Template::Plain) | Err(_) => Vec::new(),
                };
                let first =
                    |path: &template::Path<'_>| path.text.split('.').next().and_then(|name| params.get(name));
                found.extend(paths.iter().filter_map(first).map(|at| (*at, node.span)));
            }
            Value::Null | Value::Bool(_) | Value::Number(..) | Value::Broken => {}
        }
    }
    found
}

fn param_cycle(cycle: &[usize], names: &[&Key], uses: &[Vec<(usize, Span)>]) -> Problem {
    let text = |at: usize| format!("`{}`", names[at].text);
    let path: Vec<String> = cycle.iter().chain(cycle.first()).map(|at| text(*at)).collect();
    let place = |at: usize, next: usize| {
        let reference = uses[at].iter().find(|(need, _)| *need == next);
        reference.map_or(names[at].span, |(_, span)| *span)
    };
    let next = |at: usize| cycle[(at + 1) % cycle.len()];
    let first = Problem::new(
        place(cycle[0], next(0)),
        format!("params refer to each other in a cycle: {}", path.join(" -> ")),
    )
    .label(format!("{} refers to {}", text(cycle[0]), text(next(0))))
    .hint("give one of them a value of its own");
    (1..cycle.len().min(8)).fold(first, |problem, at| {
        let label = format!("{} refers to {}", text(cycle[at]), text(next(at)));
        problem.related(place(cycle[at], next(at)), label)
    })
}

/// Evaluates the axes under `axes`.
pub(super) fn axes(spec: &Spec, layers: &Layers<'_>, scope: &Scope<'_>, filler: &mut Filler<'_>) -> Axes {
    let mut axes = Axes::default();
    for (key, _) in spec.base.axes.iter() {
        let axis = axis(key, None, &layers.axis(&key.text), scope, filler);
        axes.0.insert(key.text.clone(), axis);
    }
    axes
}

/// An axis of these values, lowest first, laid over `below`.
pub(super) fn axis(
    name: &Key,
    below: Option<Axis>,
    layers: &[&Node],
    scope: &Scope<'_>,
    filler: &mut Filler<'_>,
) -> Option<Axis> {
    let mut axis = below;
    for node in layers {
        let node = filler.fill(node, scope)?;
        axis = Some(axes::lay(axis, name, node, filler.problems)?);
    }
    axis
}

/// The seed that `node` gives.
pub(super) fn seed(node: &Node, scope: &Scope<'_>, filler: &mut Filler<'_>) -> Option<u64> {
    let value = filler.fill(node, scope)?;
    let number = match &value.value {
        Value::Number(number, _) => number.as_u64(),
        _ => None,
    };
    if number.is_none() {
        let at = if value.span.is_empty() { node.span } else { value.span };
        let hint = match value.scalar_text() {
            Some(text) if text.parse::<u64>().is_ok() && node.scalar_text().is_none_or(|it| it != text) => {
                "names of values with fields are texts: add a field `seed`, and write `$axis.seed`"
            }
            _ => "write a number, or `$axis` for one seed per instance",
        };
        filler.problems.add(|| {
            Problem::new(
                at,
                format!(
                    "the seed of {} is {}, expected a whole number of at least 0",
                    scope.place,
                    value.describe()
                ),
            )
            .maybe_related(value.via, "used here")
            .hint(hint)
        });
    }
    number
}
