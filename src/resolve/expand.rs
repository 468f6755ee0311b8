//! Expands stages to instances: the parameters of each instance are merged from defaults, stage, profile and `--set`, and checked
//! by its kind.

use std::collections::{BTreeMap, BTreeSet, HashMap};

use dril_stage_api::{Kind, Look, Needs, Outside, Ports, Seed};
use serde_json::Value as Json;

use super::axes::{Axis, AxisValue};
use super::context::{MAX_INSTANCES, ResolveContext};
use super::globals;
use super::grid::{self, Grid};
use super::items::beside;
use super::params;
use super::scope::{Filler, Scope};
use crate::spec::model::{Defaults, Stage};
use crate::spec::node::{Key, Node, Value};
use crate::spec::problem::Problem;
use crate::spec::source::Span;
use crate::spec::suggest;

/// A stage with its instances.
pub(super) struct Expanded<'a> {
    pub stage: &'a Stage,
    /// `None` where it is unknown, which was reported.
    pub kind: Option<Kind>,
    /// `None` where its matrix is invalid, which was reported; then there are no instances.
    pub grid: Option<Grid>,
    /// The number of its first instance in the graph.
    pub first: usize,
    /// In the order of the grid; `None` for an invalid one, which was reported.
    pub instances: Vec<Option<Instance>>,
    /// Its input references: the stage's own, then those of its kind's defaults.
    pub inputs: Vec<(&'a Key, &'a Node)>,
}

/// The number of problems that are reported per stage; more would only repeat them.
pub(super) const ENOUGH: usize = 20;

/// An instance, without its connections.
pub(super) struct Instance {
    pub params: Json,
    pub ports: Ports,
    pub needs: Needs,
    pub seed: Option<Seed>,
    /// The file that it imports, and the place in the pipeline file.
    pub outside: Option<(Outside, Span)>,
}

impl Expanded<'_> {
    /// Its name.
    pub fn name(&self) -> &str {
        &self.stage.name.text
    }

    /// The axes; empty where they are invalid.
    pub fn axes(&self) -> &[Axis] {
        self.grid.as_ref().map(Grid::axes).unwrap_or_default()
    }

    /// Axis and value of an instance, in the order of the matrix.
    pub fn coordinates(&self, instance: usize) -> Vec<(&str, &AxisValue)> {
        self.grid.as_ref().map(|grid| grid.coordinates(instance)).unwrap_or_default()
    }

    /// `dril[expert=clipped, policy=beta]`.
    pub fn id(&self, instance: usize) -> String {
        let coordinates = self.coordinates(instance);
        if coordinates.is_empty() {
            return self.name().to_owned();
        }
        let pairs: Vec<String> =
            coordinates.iter().map(|(axis, value)| format!("{axis}={}", value.label)).collect();
        format!("{}[{}]", self.name(), pairs.join(", "))
    }
}

/// Expands all stages, in the order of the file.
pub(super) fn expand<'a>(context: &ResolveContext<'a>, filler: &mut Filler<'_>) -> Vec<Expanded<'a>> {
    let defaults = context.layers.defaults();
    unknown_kinds(context, &defaults, filler);
    let mut total = 0;
    let mut all = Vec::with_capacity(context.spec.stages.len());
    for stage in &context.spec.stages {
        let shared = stage.kind.as_ref().and_then(|kind| defaults.get(&*kind.text));
        let shared = shared.map_or(&[] as &[&Defaults], Vec::as_slice);
        let mut expanded = Expanded {
            stage,
            kind: kind(stage, context, filler),
            grid: grid::grid(stage, context, filler),
            first: total,
            instances: Vec::new(),
            inputs: wiring(stage, shared),
        };
        let count = expanded.grid.as_ref().map_or(0, Grid::len);
        total = total.saturating_add(count);
        if total > MAX_INSTANCES {
            filler.problems.add(|| {
                let message =
                    format!("with this stage, the pipeline has more than {MAX_INSTANCES} stage instances");
                Problem::new(stage.name.span, message).hint("does its matrix have too many axes?")
            });
            break;
        }
        expanded.instances = instances(&expanded, shared, count, context, filler);
        all.push(expanded);
    }
    all
}

fn unknown_kinds(
    context: &ResolveContext<'_>,
    defaults: &HashMap<&str, Vec<&Defaults>>,
    filler: &mut Filler<'_>,
) {
    let keys = defaults.values().flatten().map(|defaults| &defaults.kind);
    for key in keys.filter(|key| context.registry.get(&key.text).is_none()) {
        filler.problems.add(|| unknown_kind(key, "defaults for the unknown kind", context));
    }
}

fn unknown_kind(key: &Key, what: &str, context: &ResolveContext<'_>) -> Problem {
    let name = crate::spec::node::shorten(&key.text);
    Problem::new(key.span, format!("{what} `{name}`"))
        .hint(suggest::hint(&key.text, "the kinds", context.registry.iter().map(Kind::name)))
        .hint("`dril-pipe kinds` describes them")
}

fn kind(stage: &Stage, context: &ResolveContext<'_>, filler: &mut Filler<'_>) -> Option<Kind> {
    let key = stage.kind.as_ref()?;
    let kind = context.registry.get(&key.text).copied();
    if kind.is_none() {
        let what = format!("stage `{}` has the unknown kind", stage.name.text);
        filler.problems.add(|| unknown_kind(key, &what, context));
    }
    kind
}

/// The input references of a stage. For each input, the stage's own replaces that of the defaults.
fn wiring<'a>(stage: &'a Stage, defaults: &[&'a Defaults]) -> Vec<(&'a Key, &'a Node)> {
    let mut inputs: Vec<(&Key, &Node)> = stage.inputs.iter().map(|(key, node)| (key, node)).collect();
    // The highest layer first, so that it wins.
    for (key, node) in defaults.iter().rev().flat_map(|defaults| &defaults.inputs) {
        if inputs.iter().all(|(known, _)| known.text != key.text) {
            inputs.push((key, node));
        }
    }
    inputs
}

fn instances<'a>(
    expanded: &Expanded<'a>,
    defaults: &[&'a Defaults],
    count: usize,
    context: &ResolveContext<'a>,
    filler: &mut Filler<'_>,
) -> Vec<Option<Instance>> {
    let stage = expanded.stage;
    let layers = layers(stage, defaults, context);
    let place = format!("stage `{}`", stage.name.text);
    let before = filler.problems.reports();
    let build = |instance| {
        if filler.problems.reports() > before + ENOUGH || filler.problems.is_full() {
            return None;
        }
        let scope = Scope {
            globals: context.globals,
            axes: expanded.coordinates(instance),
            all_axes: context.axis_places,
            place: &place,
        };
        instance_of(expanded, &layers, &scope, context, filler)
    };
    (0..count).map(build).collect()
}

/// The parameters of a stage, the lowest layer first.
fn layers<'a>(stage: &'a Stage, defaults: &[&'a Defaults], context: &ResolveContext<'a>) -> Vec<&'a Node> {
    let own = defaults.iter().filter_map(|defaults| defaults.with.as_ref()).chain(&stage.with);
    own.chain(context.layers.stage(&stage.name.text)).collect()
}

/// The parameters of an instance with their places, for problems that are found after its expansion.
pub(super) fn parameters(
    stage: &Stage,
    scope: &Scope<'_>,
    context: &ResolveContext<'_>,
    filler: &mut Filler<'_>,
) -> Option<Node> {
    let defaults = context.layers.defaults();
    let shared = stage.kind.as_ref().and_then(|kind| defaults.get(&*kind.text));
    let shared = shared.map_or(&[] as &[&Defaults], Vec::as_slice);
    with(&layers(stage, shared, context), scope, filler)
}

/// A stage reads a variable whose value cannot enter a key.
fn value_is_no_text(stage: &str, name: &str, at: Span) -> Problem {
    let text = format!(
        "stage `{stage}` reads the variable `{name}`, whose value is not UTF-8 and cannot enter a key"
    );
    Problem::new(at, text)
        .hint("set it to valid UTF-8, or list it under `pass_env`, whose values do not enter the key")
}

fn instance_of(
    expanded: &Expanded<'_>,
    layers: &[&Node],
    scope: &Scope<'_>,
    context: &ResolveContext<'_>,
    filler: &mut Filler<'_>,
) -> Option<Instance> {
    let (pipeline_seed, environment) = (context.seed, &context.choices.environment);
    let stage = expanded.stage;
    let with = with(layers, scope, filler);
    let own_seed = stage.seed.as_ref().map(|node| globals::seed(node, scope, filler));
    let (kind, with) = (expanded.kind?, with?);
    let whole = stage.with.as_ref().map_or(stage.name.span, |with| with.span);
    let mut checked = kind.look(&params::to_params(&with, kind.texts()));
    if let Ok(look) = &mut checked
        && from_environment(&kind, &mut look.params, environment)
    {
        checked = kind.look(&look.params);
    }
    if let Ok(look) = &checked
        && let Some(name) = not_text(&kind, &look.params, &context.choices.not_text)
    {
        filler.problems.add(|| value_is_no_text(&stage.name.text, name, whole));
        return None;
    }
    if own_seed.is_some() && checked.as_ref().is_ok_and(|look| !look.seeded) {
        let at = stage.seed.as_ref().map_or(stage.name.span, |seed| seed.span);
        filler.problems.add(|| {
            Problem::new(
                at,
                format!("stage `{}` has a seed, but kind `{}` is not seeded", stage.name.text, kind.name()),
            )
            .hint(if kind.is_program() {
                "write `{seed}` in the command where its program takes the seed, or remove `seed`"
            } else {
                "remove `seed`"
            })
        });
    }
    match checked {
        Ok(Look { params, ports, needs, seeded }) => {
            let seed = own_seed.unwrap_or(pipeline_seed);
            let seed = if seeded { Some(Seed(seed?)) } else { None };
            let outside = ports.outside.clone().map(|outside| {
                let at = with.get(outside.param).map_or(whole, |(_, node)| node.span);
                let path = beside(&filler.sources.get(at).folder, &outside.path);
                (Outside { path, ..outside }, at)
            });
            Some(Instance { params, ports, needs, seed, outside })
        }
        Err(found) => {
            // An invalid field can make its parent invalid, too; that is not reported again.
            let echo = |at: usize| {
                let path = &found[at].path;
                found[..at]
                    .iter()
                    .any(|earlier| earlier.path.len() > path.len() && earlier.path.starts_with(path))
            };
            for problem in (0..found.len()).filter(|at| !echo(*at)).map(|at| &found[at]) {
                filler.problems.add(|| params::explain(problem, &with, &stage.name.text, whole));
            }
            None
        }
    }
}

/// Fills in the values of environment variables that the parameters name without a value; true where there was one.
fn from_environment(kind: &Kind, params: &mut Json, environment: &BTreeMap<String, String>) -> bool {
    let mut filled = false;
    let variables = kind.environment().and_then(|field| params.get_mut(field)?.as_object_mut());
    for (name, value) in variables.into_iter().flatten().filter(|(_, value)| value.is_null()) {
        if let Some(found) = environment.get(name) {
            // What it contains is no template: only the file's own texts are.
            *value = Json::String(kind.literal(found));
            filled = true;
        }
    }
    filled
}

/// A variable that the stage reads and that is not UTF-8.
fn not_text<'n>(kind: &Kind, params: &Json, not_text: &'n BTreeSet<String>) -> Option<&'n String> {
    let variables = kind.environment().and_then(|field| params.get(field)?.as_object())?;
    not_text.iter().find(|name| variables.get(*name).is_some_and(Json::is_null))
}

/// The merged parameters of an instance; an empty map where there are none.
fn with(layers: &[&Node], scope: &Scope<'_>, filler: &mut Filler<'_>) -> Option<Node> {
    let mut maps = Vec::new();
    let mut fine = true;
    for layer in layers {
        match filler.fill(layer, scope) {
            Some(node) => match &node.value {
                Value::Map(_) => maps.push(node),
                Value::Null => {}
                _ => {
                    fine = false;
                    filler.problems.add(|| {
                        Problem::new(
                            node.span,
                            format!(
                                "the parameters of {} are {}, expected a map of fields",
                                scope.place,
                                node.describe()
                            ),
                        )
                        .maybe_related(node.via, "used here")
                        .hint("write `with: { field: value }`")
                    });
                }
            },
            None => fine = false,
        }
    }
    let empty = Node::new(Value::Map(Vec::new()), Span::new(0, 0..0));
    fine.then(|| maps.into_iter().reduce(super::merge::merge).unwrap_or(empty))
}
