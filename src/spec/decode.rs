//! From a tree of nodes to a [`Spec`]: knows every key of the language, and reports each that is unknown or misplaced.
//!
//! A misspelt key is reported and then taken for the one that was meant, so that it does not cause a second message
//! about what is missing.

use std::collections::HashMap;
use std::sync::Arc;

use super::SourceName;
use super::layer::{self, Known};
use super::limits;
use super::model::{Defaults, Entries, Layer, MatrixAxis, Profile, Spec, Stage};
use super::names;
use super::node::{Key, Node, UNUSABLE, Value};
use super::problem::{Problem, Problems};
use super::source::{Source, Span};
use super::suggest;

const TOP: [&str; 7] = ["name", "seed", "params", "axes", "defaults", "stages", "profiles"];
const STAGE: [&str; 9] =
    ["kind", "about", "matrix", "seed", "with", "inputs", "retries", "timeout", "memory"];

/// Decodes the whole file.
pub(super) fn spec(root: Node, name: SourceName, source: Arc<Source>, mut problems: Problems) -> Spec {
    let at = root.span;
    let mut top = Fields::read(root, &TOP, "the pipeline file", &mut problems);
    let pipeline = pipeline_name(top.take("name"), at, &mut problems);
    let mut base = Layer { seed: top.take("seed").map(|(_, node)| node), ..Layer::default() };
    base.params = Entries::new(named(top.take("params"), "param", &mut problems));
    base.axes = Entries::new(named(top.take("axes"), "axis", &mut problems));
    base.defaults = layer::defaults(top.take("defaults").map(|(_, node)| node), &mut problems);
    let stages = stages(top.take("stages"), at, &mut problems);
    let known = Known::new(&base, &stages);
    let profiles = profiles(top.take("profiles"), &known, &mut problems);
    clashes(&base, &stages, &mut problems);
    Spec { name, source, problems, pipeline, base, stages, profiles }
}

/// The fields of a map, taken out one by one.
pub(super) struct Fields(Vec<(Key, Node)>);

impl Fields {
    /// The fields of `node`, which is `what`; unknown ones are reported.
    pub fn read(node: Node, known: &[&str], what: &str, problems: &mut Problems) -> Self {
        let mut fields: Vec<(Key, Node)> = Vec::new();
        for (mut key, value) in entries(node, what, problems) {
            if !known.contains(&&*key.text) {
                problems.add(|| {
                    Problem::new(
                        key.span,
                        format!("{what} has the unknown key `{}`", super::node::shorten(&key.text)),
                    )
                    .hint(suggest::hint(&key.text, "its keys", known.iter().copied()))
                });
                let meant = suggest::nearest(&key.text, known.iter().copied());
                let Some(meant) = meant.filter(|meant| fields.iter().all(|(key, _)| &*key.text != *meant))
                else {
                    continue;
                };
                key.text = meant.into();
            }
            fields.push((key, value));
        }
        Self(fields)
    }

    /// Removes and gives a field.
    pub fn take(&mut self, name: &str) -> Option<(Key, Node)> {
        let at = self.0.iter().position(|(key, _)| &*key.text == name)?;
        Some(self.0.remove(at))
    }
}

/// The entries of a map; of nothing, none; anything else is reported.
pub(super) fn entries(node: Node, what: &str, problems: &mut Problems) -> Vec<(Key, Node)> {
    match node.value {
        Value::Map(mut entries) => {
            entries.retain(|(key, _)| &*key.text != UNUSABLE);
            entries
        }
        Value::Null | Value::Broken => Vec::new(),
        _ => {
            problems.add(|| {
                Problem::new(node.span, format!("{what} is {}, expected a map", node.describe()))
                    .hint("a map is written as `{ name: value }`, or with one `name: value` a line")
            });
            Vec::new()
        }
    }
}

fn pipeline_name(field: Option<(Key, Node)>, at: Span, problems: &mut Problems) -> String {
    let expected = "expected a name of lower case words, as in `name: lunar-lander`";
    let Some((key, node)) = field else {
        problems
            .add(|| Problem::new(at, "the pipeline has no name").hint("add `name: my-pipeline` at the top"));
        return String::new();
    };
    match node.scalar_text() {
        Some(text) if names::is_kebab(&text) => text.to_string(),
        _ => {
            let at = if node.span.is_empty() { key.span } else { node.span };
            problems.add(|| {
                Problem::new(at, format!("the pipeline's name is {}, {expected}", node.describe()))
                    .hint("letters a to z, digits, and `-` between words: results are kept in a folder of that name")
            });
            String::new()
        }
    }
}

/// A map of identifiers; names that are none are reported.
fn named(field: Option<(Key, Node)>, what: &str, problems: &mut Problems) -> Vec<(Key, Node)> {
    let Some((key, node)) = field else { return Vec::new() };
    let entries = entries(node, &format!("`{}`", key.text), problems);
    entries.into_iter().filter(|(key, _)| value_name(key, what, problems)).collect()
}

/// True where the key may name a param or an axis.
fn value_name(key: &Key, what: &str, problems: &mut Problems) -> bool {
    if names::RESERVED_VALUES.contains(&&*key.text) {
        problems.add(|| {
            Problem::new(
                key.span,
                format!("the name `{}` is taken, expected another for this {what}", key.text),
            )
            .hint("`$profile` and `$pipeline` are there in every pipeline, and `name` labels a named fan-in")
        });
        return false;
    }
    identifier(key, what, problems)
}

fn identifier(key: &Key, what: &str, problems: &mut Problems) -> bool {
    let fine = names::is_identifier(&key.text);
    if !fine {
        problems.add(|| {
            let name = super::node::shorten(&key.text);
            Problem::new(
                key.span,
                format!("`{name}` cannot name a {what}, expected a letter, then letters, digits, `-` or `_`"),
            )
        });
    }
    fine
}

fn stages(field: Option<(Key, Node)>, at: Span, problems: &mut Problems) -> Vec<Stage> {
    let Some((key, node)) = field else {
        problems.add(|| {
            Problem::new(at, "the pipeline has no stages, expected a map under `stages`")
                .hint("a stage is written as `stages: { my-stage: { kind: ... } }`; `dril-pipe kinds` lists the kinds")
        });
        return Vec::new();
    };
    if let Value::List(_) = &node.value {
        problems.add(|| {
            Problem::new(node.span, "`stages` is a list, expected a map")
                .hint("each stage stands under its name, without `-`, as in `my-stage: { kind: ... }`")
        });
        return Vec::new();
    }
    let empty = match &node.value {
        Value::Map(entries) => entries.is_empty(),
        other => matches!(other, Value::Null),
    };
    let entries = entries(node, "`stages`", problems);
    if empty {
        problems.add(|| {
            Problem::new(key.span, "the pipeline has no stages, expected at least one")
                .hint("`dril-pipe kinds` lists the kinds of stages that there are")
        });
    }
    entries.into_iter().filter_map(|(name, node)| stage(name, node, problems)).collect()
}

fn stage(name: Key, node: Node, problems: &mut Problems) -> Option<Stage> {
    if names::RESERVED_STAGES.contains(&&*name.text) {
        problems.add(|| {
            Problem::new(name.span, format!("a stage cannot be called `{}`", name.text)).hint(
                "in a profile and after `--set` that word stands for a part of the file; choose another",
            )
        });
        return None;
    }
    if !identifier(&name, "stage", problems) {
        return None;
    }
    let what = format!("stage `{}`", name.text);
    if !matches!(node.value, Value::Map(_) | Value::Null) {
        problems.add(|| {
            Problem::new(node.span, format!("{what} is {}, expected a map", node.describe()))
                .hint(format!("write `{}: {{ kind: ... }}`", name.text))
        });
        return None;
    }
    let mut fields = Fields::read(node, &STAGE, &what, problems);
    let kind = stage_kind(&name, fields.take("kind"), problems);
    if let Some((key, about)) = fields.take("about")
        && !matches!(about.value, Value::Text(_))
    {
        problems.add(|| Problem::new(key.span, format!("`about` is {}, expected a text", about.describe())));
    }
    let matrix = fields.take("matrix").map(|(_, node)| matrix(node, problems)).unwrap_or_default();
    let inputs =
        fields.take("inputs").map(|(_, node)| entries(node, "`inputs`", problems)).unwrap_or_default();
    let (retries, timeout, memory) = (fields.take("retries"), fields.take("timeout"), fields.take("memory"));
    let limits = limits::limits(retries, timeout, memory, problems);
    let mut optional = |field: &str| fields.take(field).map(|(key, node)| placed(key, node));
    let (seed, with) = (optional("seed"), optional("with"));
    Some(Stage { name, kind, matrix, seed, with, inputs, limits })
}

/// The node; where nothing is written, it stands where its key does.
fn placed(key: Key, mut node: Node) -> Node {
    if node.span.is_empty() {
        node.span = key.span;
    }
    node
}

fn stage_kind(name: &Key, field: Option<(Key, Node)>, problems: &mut Problems) -> Option<Key> {
    let Some((key, node)) = field else {
        problems.add(|| {
            Problem::new(name.span, format!("stage `{}` has no kind", name.text))
                .hint("add `kind: ...`; `dril-pipe kinds` lists the kinds")
        });
        return None;
    };
    match node.value {
        Value::Text(text) => Some(Key { text, span: node.span }),
        _ => {
            let node = placed(key, node);
            problems.add(|| {
                Problem::new(
                    node.span,
                    format!("the kind of stage `{}` is {}, expected a name", name.text, node.describe()),
                )
                .hint("`dril-pipe kinds` lists the kinds")
            });
            None
        }
    }
}

/// `[expert, seed]`, `{ k: [1, 2] }`, or a list that mixes names and such maps.
fn matrix(node: Node, problems: &mut Problems) -> Vec<MatrixAxis> {
    let mut axes = Vec::new();
    match node.value {
        Value::Null => {}
        Value::List(items) => items.into_iter().for_each(|item| matrix_item(item, &mut axes, problems)),
        Value::Map(_) => matrix_item(node, &mut axes, problems),
        _ => problems.add(|| {
            Problem::new(node.span, format!("`matrix` is {}, expected a list of axes", node.describe())).hint(
                "write `matrix: [expert, seed]`, or `matrix: { k: [1, 2] }` for values of this stage only",
            )
        }),
    }
    let mut seen: Vec<MatrixAxis> = Vec::new();
    for axis in axes {
        match seen.iter().find(|earlier| earlier.name.text == axis.name.text) {
            Some(earlier) => problems.add(|| {
                Problem::new(
                    axis.name.span,
                    format!("the axis `{}` stands in this matrix twice", axis.name.text),
                )
                .related(earlier.name.span, "first")
                .hint("remove one of the two")
            }),
            None => seen.push(axis),
        }
    }
    seen
}

fn matrix_item(item: Node, axes: &mut Vec<MatrixAxis>, problems: &mut Problems) {
    match item.value {
        Value::Text(text) => axes.push(MatrixAxis { name: Key { text, span: item.span }, values: None }),
        Value::Map(entries) => {
            for (name, values) in entries {
                if value_name(&name, "axis", problems) {
                    axes.push(MatrixAxis { values: Some(placed(name.clone(), values)), name });
                }
            }
        }
        _ => problems.add(|| {
            Problem::new(
                item.span,
                format!("found {} in a matrix, expected the name of an axis", item.describe()),
            )
            .hint("values of this stage only are written as `matrix: { k: [1, 2] }`")
        }),
    }
}

fn profiles(field: Option<(Key, Node)>, known: &Known<'_>, problems: &mut Problems) -> Vec<Profile> {
    let Some((_, node)) = field else { return Vec::new() };
    let mut profiles = Vec::new();
    for (name, node) in entries(node, "`profiles`", problems) {
        if identifier(&name, "profile", problems) {
            let layer = layer::overrides(node, known, &format!("profile `{}`", name.text), problems);
            profiles.push(Profile { name, layer });
        }
    }
    profiles
}

/// A name that is both an axis and a param would mean one thing in one stage and another in the next.
fn clashes(base: &Layer, stages: &[Stage], problems: &mut Problems) {
    let inline = stages.iter().flat_map(|stage| &stage.matrix).filter(|axis| axis.values.is_some());
    let axes = base.axes.iter().map(|(key, _)| key).chain(inline.map(|axis| &axis.name));
    let params: HashMap<&str, Span> = base.params.iter().map(|(key, _)| (&*key.text, key.span)).collect();
    for axis in axes {
        if let Some(param) = params.get(&*axis.text) {
            problems.add(|| {
                Problem::new(axis.span, format!("`{}` is both an axis and a param", axis.text))
                    .label("axis")
                    .related(*param, "param")
                    .hint("rename one of the two: `$` must mean one thing only")
            });
        }
    }
}

/// Not used for the file's own defaults only: also what a profile or `--set` says of a kind.
pub(super) fn kind_defaults(kind: Key, node: Node, problems: &mut Problems) -> Defaults {
    let what = format!("the defaults of kind `{}`", kind.text);
    let mut fields = Fields::read(node, &["with", "inputs"], &what, problems);
    let with = fields.take("with").map(|(key, node)| placed(key, node));
    let inputs =
        fields.take("inputs").map(|(_, node)| entries(node, "`inputs`", problems)).unwrap_or_default();
    Defaults { kind, with, inputs }
}
