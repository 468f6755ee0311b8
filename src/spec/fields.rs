//! The parts of a map in a pipeline file: known fields, free names, and values that are not written.

use super::model::Defaults;
use super::names;
use super::node::{Key, Node, UNUSABLE, Value};
use super::problem::{Problem, ProblemList};
use super::suggest;

/// The fields of a map, to be taken one by one.
pub(super) struct Fields(Vec<(Key, Node)>);

impl Fields {
    /// Reads the fields of `node`, which is `what`; unknown ones are reported.
    pub fn read(node: Node, known: &[&str], what: &str, problems: &mut ProblemList) -> Self {
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

    /// Takes a field.
    pub fn take(&mut self, name: &str) -> Option<(Key, Node)> {
        let at = self.0.iter().position(|(key, _)| &*key.text == name)?;
        Some(self.0.remove(at))
    }
}

/// The entries of a map; none where nothing is written; anything else is reported.
pub(super) fn entries(node: Node, what: &str, problems: &mut ProblemList) -> Vec<(Key, Node)> {
    match node.value {
        Value::Map(mut entries) => {
            entries.retain(|(key, _)| &*key.text != UNUSABLE);
            entries
        }
        Value::Null | Value::Broken => Vec::new(),
        _ => {
            problems.add(|| {
                Problem::new(node.span, format!("{what} is {}, expected a map", node.describe()))
                    .hint("write a map as `{ name: value }`, or with one `name: value` per line")
            });
            Vec::new()
        }
    }
}

/// True where the key is a valid name of a param or an axis.
pub(super) fn value_name(key: &Key, what: &str, problems: &mut ProblemList) -> bool {
    if names::RESERVED_VALUES.contains(&&*key.text) {
        problems.add(|| {
            Problem::new(
                key.span,
                format!("the name `{}` is reserved, expected another one for this {what}", key.text),
            )
            .hint("every pipeline has `$profile` and `$pipeline`, and `name` labels a named fan-in")
        });
        return false;
    }
    identifier(key, what, problems)
}

pub(super) fn identifier(key: &Key, what: &str, problems: &mut ProblemList) -> bool {
    let fine = names::is_identifier(&key.text);
    if !fine {
        problems.add(|| {
            let name = super::node::shorten(&key.text);
            let article = if what.starts_with(['a', 'e', 'i', 'o', 'u']) { "an" } else { "a" };
            Problem::new(
                key.span,
                format!("`{name}` cannot name {article} {what}, expected a letter, then letters, digits, `-` or `_`"),
            )
        });
    }
    fine
}

/// The node; one without text gets the place of its key.
pub(super) fn placed(key: Key, mut node: Node) -> Node {
    if node.span.is_empty() {
        node.span = key.span;
    }
    node
}

/// The defaults of a kind: in the file itself, in a profile, or by `--set`.
pub(super) fn kind_defaults(kind: Key, node: Node, problems: &mut ProblemList) -> Defaults {
    let what = format!("the defaults of kind `{}`", kind.text);
    let mut fields = Fields::read(node, &["with", "inputs"], &what, problems);
    let with = fields.take("with").map(|(key, node)| placed(key, node));
    let inputs =
        fields.take("inputs").map(|(_, node)| entries(node, "`inputs`", problems)).unwrap_or_default();
    Defaults { kind, with, inputs }
}
