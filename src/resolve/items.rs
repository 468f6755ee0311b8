//! Parses the value of an input: a reference or file, a list of these, or a map of names to these.

use std::sync::Arc;

use dril_stage_api::{Arity, Input};

use super::reference;
use super::scope::{Filler, Scope};
use super::template::{self, Lone, Template};
use crate::spec::include::joined;
use crate::spec::node::{Key, Node, Value};
use crate::spec::problem::Problem;
use crate::spec::source::Span;

/// A single reference or file.
pub(super) struct Item {
    /// Its name in a named fan-in.
    pub name: Option<Arc<str>>,
    /// Its place.
    pub node: Node,
    pub what: What,
}

/// What an [`Item`] is.
pub(super) enum What {
    /// The path of a file.
    File(String),
    /// The text of a reference.
    Stage(String),
}

/// Parses the value of one input.
pub(super) struct Unpacker<'u, 'p> {
    pub filler: &'u mut Filler<'p>,
    pub scope: &'u Scope<'u>,
    pub input: &'u Input,
    /// Its place in `inputs`.
    pub at: Span,
    /// What was found.
    pub items: Vec<Item>,
    /// True where something was reported.
    pub broken: bool,
}

/// The position in the value.
#[derive(Clone, Copy, Default)]
struct Inside<'n> {
    /// In a named fan-in, under this name.
    name: Option<&'n Arc<str>>,
    /// In the value of a `$name`, where every `$` has been filled in already.
    value: bool,
}

impl Unpacker<'_, '_> {
    /// Adds what `node` holds to the items.
    pub fn unpack(&mut self, node: &Node) {
        self.node(node, Inside::default());
    }

    fn node(&mut self, node: &Node, inside: Inside<'_>) {
        match &node.value {
            Value::Text(text) => self.text(text, node, inside),
            Value::List(list) if !list.is_empty() => list.iter().for_each(|node| self.node(node, inside)),
            Value::Map(entries) if entries.iter().any(|(key, _)| &*key.text == "file") => {
                self.file(entries, node, inside);
            }
            Value::Map(entries) if inside.name.is_none() && !entries.is_empty() => {
                if self.input.arity != Arity::Many {
                    return self.named_single(node);
                }
                entries
                    .iter()
                    .for_each(|(key, node)| self.node(node, Inside { name: Some(&key.text), ..inside }));
            }
            Value::Broken => self.broken = true,
            _ => self.no_wiring(node),
        }
    }

    fn text(&mut self, text: &str, node: &Node, inside: Inside<'_>) {
        if !inside.value
            && let Ok(Template::Exact(path)) = template::parse(text, Lone::Keep)
        {
            let at = self.filler.within(node, text, path.range.clone());
            return match self.filler.value(&path, at, self.scope) {
                Some(value) => self.node(&value.brought_in(at), Inside { value: true, ..inside }),
                None => self.broken = true,
            };
        }
        let filled =
            if inside.value { Some(text.to_owned()) } else { self.filler.braces(text, node, self.scope) };
        match filled {
            Some(text) => self.add(node, What::Stage(text), inside),
            None => self.broken = true,
        }
    }

    fn add(&mut self, node: &Node, what: What, inside: Inside<'_>) {
        self.items.push(Item { name: inside.name.cloned(), node: node.clone(), what });
    }

    fn file(&mut self, entries: &[(Key, Node)], node: &Node, inside: Inside<'_>) {
        let [(key, path)] = entries else {
            return self.report(|| {
                Problem::new(
                    node.span,
                    "found `file` together with other names, expected only `{ file: path }`",
                )
                .hint("in a named fan-in, write `{ my-name: { file: path }, ... }`")
            });
        };
        let filled = if inside.value { Some(path.clone()) } else { self.filler.fill(path, self.scope) };
        let Some(path) = filled else {
            self.broken = true;
            return;
        };
        match &path.value {
            Value::Text(text) if !text.is_empty() && !text.contains('\0') => {
                let folder = &self.filler.sources.get(path.span).folder;
                self.add(&path, What::File(beside(folder, text)), inside);
            }
            _ => self.report(|| {
                let at = if path.span.is_empty() { key.span } else { path.span };
                Problem::new(at, format!("`file` is {}, expected a path", path.describe()))
                    .hint("paths are relative to the folder of the pipeline file")
            }),
        }
    }

    fn no_wiring(&mut self, node: &Node) {
        let what = match &node.value {
            Value::List(_) => "an empty list".to_owned(),
            Value::Map(entries) if entries.is_empty() => "an empty map".to_owned(),
            Value::Map(_) => "a map inside a map".to_owned(),
            _ => node.describe(),
        };
        let at = if node.span.is_empty() { self.at } else { node.span };
        let input = self.input.name;
        self.report(|| {
            Problem::new(
                at,
                format!("found {what} at input `{input}`, expected a reference to a stage or a file"),
            )
            .hint(reference::FORM)
        });
    }

    fn named_single(&mut self, node: &Node) {
        let input = self.input.name;
        self.report(|| {
            Problem::new(node.span, format!("input `{input}` takes one artifact, but found a map of names"))
                .hint("only inputs that take many artifacts can name them")
                .hint(reference::FORM)
        });
    }

    fn report(&mut self, problem: impl FnOnce() -> Problem) {
        self.broken = true;
        self.filler.problems.add(problem);
    }
}

/// A path in a file in `folder`, relative to the folder of the pipeline file.
pub(super) fn beside(folder: &str, path: &str) -> String {
    if folder.is_empty() { path.to_owned() } else { joined(folder, path) }
}
