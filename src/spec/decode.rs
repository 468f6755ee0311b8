//! Decodes trees of nodes, one per file, to a [`Spec`]: knows every key of the language, and reports unknown and misplaced keys.
//!
//! A misspelt key is reported and then treated as the nearest one, so that it does not cause a second message about a missing
//! key.

use std::collections::{HashMap, HashSet};
use std::sync::Arc;

use super::SourceName;
use super::fields::{Fields, entries, identifier, placed, value_name};
use super::layer::{self, Known};
use super::limits;
use super::matrix;
use super::model::{Entries, Layer, Profile, Spec, Stage};
use super::names;
use super::node::{Key, Node, Value};
use super::problem::{Problem, ProblemList};
use super::source::{SourceText, Span};

pub(super) const TOP: [&str; 8] =
    ["name", "include", "seed", "params", "axes", "defaults", "stages", "profiles"];
pub(super) const STAGE: [&str; 11] = [
    "kind",
    "about",
    "matrix",
    "when",
    "seed",
    "with",
    "inputs",
    "retries",
    "timeout",
    "memory",
    "resources",
];

/// A decoded file.
pub(super) struct File {
    at: Span,
    name: Option<(Key, Node)>,
    base: Layer,
    stages: Vec<Stage>,
    profiles: Option<(Key, Node)>,
    /// The files that it includes, with the place of each.
    pub include: Vec<Key>,
}

/// Decodes one file. Its profiles wait until all files are there: they may change what another file brings along.
pub(super) fn file(root: Node, is_included: bool, problems: &mut ProblemList) -> File {
    let at = root.span;
    let mut top = Fields::read(root, &TOP, "the pipeline file", problems);
    let mut base = Layer { seed: top.take("seed").map(|(_, node)| node), ..Layer::default() };
    base.params = Entries::new(named(top.take("params"), "param", problems));
    base.axes = Entries::new(named(top.take("axes"), "axis", problems));
    base.defaults = layer::defaults(top.take("defaults").map(|(_, node)| node), problems);
    let include = top.take("include").map(|(key, node)| included(key, node, problems)).unwrap_or_default();
    // A file of shared stages needs none of its own, and neither does one that only includes.
    let field = top.take("stages");
    let may_lack = field.is_none() && (is_included || !include.is_empty());
    let stages = if may_lack { Vec::new() } else { stages(field, at, problems) };
    File { at, name: top.take("name"), base, stages, profiles: top.take("profiles"), include }
}

/// Merges files, an included one before the file that includes it; the last one is the pipeline file.
pub(super) fn spec(
    files: Vec<File>,
    name: SourceName,
    sources: Vec<Arc<SourceText>>,
    mut problems: ProblemList,
) -> Spec {
    let mut pipeline = String::new();
    let mut at = Span::new(0, 0..0);
    let count = files.len();
    let (mut layers, mut all, mut profiles) = (Vec::new(), Vec::new(), Vec::new());
    for (number, file) in files.into_iter().enumerate() {
        at = file.at;
        if number + 1 == count {
            pipeline = pipeline_name(file.name, file.at, &mut problems);
        }
        layers.push(file.base);
        profiles.push(file.profiles);
        // The names within one file differ already.
        let before: HashMap<Arc<str>, Span> =
            all.iter().map(|stage: &Stage| (stage.name.text.clone(), stage.name.span)).collect();
        for stage in file.stages {
            add_stage(stage, &mut all, &before, &mut problems);
        }
    }
    if all.is_empty() && problems.is_empty() {
        problems.add(|| {
            Problem::new(at, "the pipeline has no stages, and neither have the files that it includes")
                .hint("a stage is written as `stages: { my-stage: { kind: ... } }`; `dril-pipe kinds` lists the kinds")
        });
    }
    let names = |of: fn(&Layer) -> &Entries| {
        let mut seen = HashSet::new();
        let entries = layers.iter().flat_map(|layer| of(layer).iter());
        Entries::new(entries.filter(|(key, _)| seen.insert(key.text.clone())).cloned().collect())
    };
    let base =
        Layer { params: names(|layer| &layer.params), axes: names(|layer| &layer.axes), ..Layer::default() };
    let known = Known::new(&base, &all);
    let profiles = merged_profiles(profiles, &known, &mut problems);
    clashes(&base, &all, &mut problems);
    Spec { name, sources, problems, pipeline, base, files: layers, stages: all, profiles }
}

fn add_stage(
    stage: Stage,
    all: &mut Vec<Stage>,
    before: &HashMap<Arc<str>, Span>,
    problems: &mut ProblemList,
) {
    match before.get(&stage.name.text) {
        Some(other) => problems.add(|| {
            Problem::new(stage.name.span, format!("another file also has a stage `{}`", stage.name.text))
                .related(*other, "the other")
                .hint("rename one of the two; to change the other's parameters, use `defaults`, `params` or a profile")
        }),
        None => all.push(stage),
    }
}

/// The paths under `include`: one, or a list.
fn included(key: Key, node: Node, problems: &mut ProblemList) -> Vec<Key> {
    let node = placed(key, node);
    let items = if let Value::List(items) = node.value { items } else { vec![node] };
    let mut paths = Vec::new();
    for item in items {
        match item.value {
            Value::Text(text) if !text.is_empty() && !text.contains('\0') => {
                paths.push(Key { text, span: item.span });
            }
            _ => problems.add(|| {
                Problem::new(
                    item.span,
                    format!("`include` is {}, expected the path of a file", item.describe()),
                )
                .hint("as in `include: experts.yaml`; paths are relative to the folder of the including file")
            }),
        }
    }
    paths
}

fn pipeline_name(field: Option<(Key, Node)>, at: Span, problems: &mut ProblemList) -> String {
    let expected = "expected lower-case words with `-` between them, as in `name: lunar-lander`";
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
                Problem::new(at, format!("the pipeline's name is {}, {expected}", node.describe())).hint(
                    "use letters a to z, digits, and `-` between words: it is the name of the results folder",
                )
            });
            String::new()
        }
    }
}

/// A map of identifiers; names that are none are reported.
fn named(field: Option<(Key, Node)>, what: &str, problems: &mut ProblemList) -> Vec<(Key, Node)> {
    let Some((key, node)) = field else { return Vec::new() };
    let entries = entries(node, &format!("`{}`", key.text), problems);
    entries.into_iter().filter(|(key, _)| value_name(key, what, problems)).collect()
}

fn stages(field: Option<(Key, Node)>, at: Span, problems: &mut ProblemList) -> Vec<Stage> {
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
                .hint("write each stage under its name, without `-`, as in `my-stage: { kind: ... }`")
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
                .hint("`dril-pipe kinds` lists the stage kinds")
        });
    }
    entries.into_iter().filter_map(|(name, node)| stage(name, node, problems)).collect()
}

fn stage(name: Key, node: Node, problems: &mut ProblemList) -> Option<Stage> {
    if names::RESERVED_STAGES.contains(&&*name.text) {
        problems.add(|| {
            Problem::new(name.span, format!("a stage cannot be called `{}`", name.text))
                .hint("this word has a special meaning in profiles and `--set`; use another name")
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
    let (matrix, mut rules) =
        fields.take("matrix").map(|(_, node)| matrix::read(node, problems)).unwrap_or_default();
    let inputs =
        fields.take("inputs").map(|(_, node)| entries(node, "`inputs`", problems)).unwrap_or_default();
    let (retries, timeout, memory) = (fields.take("retries"), fields.take("timeout"), fields.take("memory"));
    let limits = limits::limits(retries, timeout, memory, problems);
    let resources = limits::resources(fields.take("resources"), problems);
    let mut optional = |field: &str| fields.take(field).map(|(key, node)| placed(key, node));
    let (seed, with) = (optional("seed"), optional("with"));
    rules.when = optional("when").filter(|node| !matches!(node.value, Value::Null));
    Some(Stage { name, kind, matrix, rules, seed, with, inputs, limits, resources })
}

fn stage_kind(name: &Key, field: Option<(Key, Node)>, problems: &mut ProblemList) -> Option<Key> {
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

/// The profiles of all files: those of the pipeline file come first, since its first one holds when none is chosen.
fn merged_profiles(
    files: Vec<Option<(Key, Node)>>,
    known: &Known<'_>,
    problems: &mut ProblemList,
) -> Vec<Profile> {
    let mut profiles: Vec<Profile> = Vec::new();
    for (_, node) in files.into_iter().rev().flatten() {
        for (name, node) in entries(node, "`profiles`", problems) {
            if !identifier(&name, "profile", problems) {
                continue;
            }
            let layer = layer::overrides(node, known, &format!("profile `{}`", name.text), problems);
            match profiles.iter_mut().find(|profile| profile.name.text == name.text) {
                // Included files have lower priority.
                Some(profile) => profile.layers.insert(0, layer),
                None => profiles.push(Profile { name, layers: vec![layer] }),
            }
        }
    }
    profiles
}

/// A name that is both an axis and a param would be ambiguous.
fn clashes(base: &Layer, stages: &[Stage], problems: &mut ProblemList) {
    let inline = stages.iter().flat_map(|stage| &stage.matrix).filter(|axis| axis.values.is_some());
    let axes = base.axes.iter().map(|(key, _)| key).chain(inline.map(|axis| &axis.name));
    let params: HashMap<&str, Span> = base.params.iter().map(|(key, _)| (&*key.text, key.span)).collect();
    for axis in axes {
        if let Some(param) = params.get(&*axis.text) {
            problems.add(|| {
                Problem::new(axis.span, format!("`{}` is both an axis and a param", axis.text))
                    .label("axis")
                    .related(*param, "param")
                    .hint("rename one of the two: `$` must be unambiguous")
            });
        }
    }
}
