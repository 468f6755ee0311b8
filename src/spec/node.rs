//! YAML values with their places. Overrides, defaults and references are merged from such values, so that problems that are found
//! later still point to the right line.

use std::sync::Arc;

use serde_json::Number;

use super::source::Span;

/// The text of an invalid key, which was reported; its value is [`Value::Broken`].
pub(crate) const UNUSABLE: &str = "<<";

/// The maximum depth of lists and maps, so that every function on a [`Node`] may recurse.
pub(crate) const MAX_DEPTH: usize = 64;

/// A value with its place.
#[derive(Clone, Debug)]
pub(crate) struct Node {
    /// What it is.
    pub value: Value,
    /// Its place: where to fix it.
    pub span: Span,
    /// The place of the `$name` or YAML alias that refers to it.
    pub via: Option<Span>,
    /// Tagged `!replace`: replaces what it overrides instead of being merged into it.
    pub replace: bool,
}

/// What a [`Node`] is.
#[derive(Clone, Debug)]
pub(crate) enum Value {
    /// Nothing, or `null`.
    Null,
    /// `true` or `false`.
    Bool(bool),
    /// A finite number, with its text as written, which is the name of the value on an axis.
    Number(Number, Arc<str>),
    /// A text; `$` is not evaluated yet.
    Text(Arc<str>),
    /// A list.
    List(Vec<Node>),
    /// A map, in the order of the file, without duplicate keys.
    Map(Vec<(Key, Node)>),
    /// An invalid value, which was reported: nothing that depends on it is reported again.
    Broken,
}

/// A name with its place.
#[derive(Clone, Debug)]
pub(crate) struct Key {
    /// The name.
    pub text: Arc<str>,
    /// Its place.
    pub span: Span,
}

impl Node {
    /// A value of the file.
    pub fn new(value: Value, span: Span) -> Self {
        Self { value, span, via: None, replace: false }
    }

    /// The same, used at `via`.
    pub fn brought_in(mut self, via: Span) -> Self {
        self.via = Some(via);
        self
    }

    /// Its place and tag without its value.
    pub fn shell(&self) -> Self {
        Self { value: Value::Null, ..*self }
    }

    /// What it is, for messages: "a list", "the text `abc`".
    pub fn describe(&self) -> String {
        match &self.value {
            Value::Null => "nothing".to_owned(),
            Value::Bool(value) => format!("`{value}`"),
            Value::Number(_, text) => format!("the number {text}"),
            Value::Text(text) => format!("the text `{}`", shorten(text)),
            Value::List(_) => "a list".to_owned(),
            Value::Map(_) => "a map".to_owned(),
            Value::Broken => "unusable".to_owned(),
        }
    }

    /// The text of a scalar; `None` for nothing, lists and maps.
    pub fn scalar_text(&self) -> Option<Arc<str>> {
        match &self.value {
            Value::Bool(value) => Some(if *value { "true".into() } else { "false".into() }),
            Value::Number(_, text) | Value::Text(text) => Some(text.clone()),
            Value::Null | Value::List(_) | Value::Map(_) | Value::Broken => None,
        }
    }

    /// The text of a scalar for use in another text: as written, except that YAML-specific notations of whole numbers (`0x1f`,
    /// `0o17`) are converted to decimal. `None` as with [`Node::scalar_text`].
    pub fn written(&self) -> Option<Arc<str>> {
        match &self.value {
            Value::Number(number, text) if text.starts_with("0x") || text.starts_with("0o") => {
                Some(number.to_string().into())
            }
            _ => self.scalar_text(),
        }
    }

    /// The entry of a map.
    pub fn get(&self, key: &str) -> Option<(&Key, &Node)> {
        let Value::Map(entries) = &self.value else { return None };
        entries.iter().find(|(at, _)| &*at.text == key).map(|(key, node)| (key, node))
    }

    /// Values in it, itself included.
    pub fn size(&self) -> usize {
        match &self.value {
            Value::List(items) => 1 + items.iter().map(Node::size).sum::<usize>(),
            Value::Map(entries) => 1 + entries.iter().map(|(_, node)| node.size()).sum::<usize>(),
            _ => 1,
        }
    }

    /// Lists and maps inside each other, 0 for a scalar.
    pub fn depth(&self) -> usize {
        match &self.value {
            Value::List(items) => 1 + items.iter().map(Node::depth).max().unwrap_or(0),
            Value::Map(entries) => 1 + entries.iter().map(|(_, node)| node.depth()).max().unwrap_or(0),
            _ => 0,
        }
    }
}

/// At most 60 characters of a text, on one line, for messages.
pub(crate) fn shorten(text: &str) -> String {
    let mut short: String = text.chars().take(60).map(|c| if c.is_control() { ' ' } else { c }).collect();
    if text.chars().nth(60).is_some() {
        short.push('…');
    }
    short
}
