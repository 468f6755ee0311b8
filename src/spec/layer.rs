//! Overrides: what a profile or `--set` changes in the file. Both use the same names.

use std::collections::HashMap;

use super::fields::{entries, kind_defaults};
use super::model::{Defaults, Entries, Layer, Stage};
use super::node::{Key, Node, shorten};
use super::problem::{Problem, ProblemList};
use super::source::Span;
use super::suggest;

const PARTS: [&str; 4] = ["seed", "params", "axes", "defaults"];

/// What there is to override, with its place.
pub(crate) struct Known<'a> {
    params: HashMap<&'a str, Span>,
    axes: HashMap<&'a str, Span>,
    stages: HashMap<&'a str, Span>,
    /// Axes that a stage's matrix defines for itself.
    inline: HashMap<&'a str, Span>,
}

impl<'a> Known<'a> {
    /// The names of the file.
    pub fn new(base: &'a Layer, stages: &'a [Stage]) -> Self {
        let place = |key: &'a Key| (&*key.text, key.span);
        let matrices = stages.iter().flat_map(|stage| &stage.matrix);
        let inline = matrices.filter(|axis| axis.values.is_some());
        Self {
            params: base.params.iter().map(|(key, _)| place(key)).collect(),
            axes: base.axes.iter().map(|(key, _)| place(key)).collect(),
            stages: stages.iter().map(|stage| place(&stage.name)).collect(),
            inline: inline.map(|axis| place(&axis.name)).collect(),
        }
    }
}

/// Reads overrides; `what` names where they are written.
pub(crate) fn overrides(node: Node, known: &Known<'_>, what: &str, problems: &mut ProblemList) -> Layer {
    let mut layer = Layer::default();
    let mut stages = Vec::new();
    for (key, node) in entries(node, what, problems) {
        match &*key.text {
            "seed" => layer.seed = Some(node),
            "params" => {
                let mut params = entries(node, &format!("`params` of {what}"), problems);
                params.retain(|(key, _)| is_param(key, known, problems));
                layer.params = Entries::new(params);
            }
            "axes" => {
                let mut axes = entries(node, &format!("`axes` of {what}"), problems);
                axes.retain(|(key, _)| is_axis(key, known, problems));
                layer.axes = Entries::new(axes);
            }
            "defaults" => layer.defaults = defaults(Some(node), problems),
            name if known.stages.contains_key(name) => stages.push((key, node)),
            _ => problems.add(|| unknown_part(&key, known)),
        }
    }
    layer.stages = Entries::new(stages);
    layer
}

/// Kind -> what its stages share.
pub(crate) fn defaults(node: Option<Node>, problems: &mut ProblemList) -> Vec<Defaults> {
    let Some(node) = node else { return Vec::new() };
    let kinds = entries(node, "`defaults`", problems);
    kinds.into_iter().map(|(kind, node)| kind_defaults(kind, node, problems)).collect()
}

fn is_param(key: &Key, known: &Known<'_>, problems: &mut ProblemList) -> bool {
    let found = known.params.contains_key(&*key.text);
    if !found {
        problems.add(|| {
            Problem::new(key.span, format!("there is no param `{}` to override", shorten(&key.text)))
                .hint(suggest::hint(&key.text, "the params", sorted(&known.params)))
                .maybe_related(
                    known.axes.get(&*key.text).copied(),
                    "there is an axis of that name under `axes`",
                )
        });
    }
    found
}

fn is_axis(key: &Key, known: &Known<'_>, problems: &mut ProblemList) -> bool {
    let found = known.axes.contains_key(&*key.text);
    if !found {
        problems.add(|| {
            Problem::new(key.span, format!("there is no axis `{}` to override", shorten(&key.text)))
                .hint(suggest::hint(&key.text, "the axes", sorted(&known.axes)))
                .maybe_related(
                    known.inline.get(&*key.text).copied(),
                    "these values belong to a matrix; move them to `axes`",
                )
        });
    }
    found
}

fn unknown_part(key: &Key, known: &Known<'_>) -> Problem {
    let name = shorten(&key.text);
    let problem = Problem::new(
        key.span,
        format!(
            "there is no stage `{name}`, expected a stage or one of `seed`, `params`, `axes`, `defaults`"
        ),
    );
    if let Some(at) = known.params.get(&*key.text) {
        return problem.related(*at, "a param").hint(format!("write `params.{name}` for a param"));
    }
    if let Some(at) = known.axes.get(&*key.text) {
        return problem.related(*at, "an axis").hint(format!("write `axes.{name}` for an axis"));
    }
    if matches!(&*key.text, "name" | "stages" | "profiles") {
        return problem.hint("write the field of a stage without `with`, as in `my-stage.total_timesteps`");
    }
    let stages = sorted(&known.stages);
    match suggest::nearest(&key.text, stages.iter().copied().chain(PARTS)) {
        Some(meant) => problem.hint(format!("did you mean `{meant}`?")),
        None => problem.hint(format!("the stages are {}", suggest::list(&stages))),
    }
}

/// The names in the order of the file.
fn sorted<'a>(names: &HashMap<&'a str, Span>) -> Vec<&'a str> {
    let mut names: Vec<(Span, &str)> = names.iter().map(|(name, at)| (*at, *name)).collect();
    names.sort_unstable();
    names.into_iter().map(|(_, name)| name).collect()
}
