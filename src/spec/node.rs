//! A YAML value that knows where it stands. Overrides, defaults and references are put together from such values, so
//! that whatever turns out wrong later still points at the line it came from.

use std::sync::Arc;

use serde_json::Number;

use super::source::Span;

/// The text of a key that could not be read, which was reported; its value is [`Value::Broken`].
pub(crate) const UNUSABLE: &str = "<<";

/// How deep lists and maps may go. Every walk over a [`Node`] may then recurse.
pub(crate) const MAX_DEPTH: usize = 64;

/// A value with its place.
#[derive(Clone, Debug)]
pub(crate) struct Node {
    /// What it is.
    pub value: Value,
    /// Where it stands: where to mend it.
    pub span: Span,
    /// Where it was brought in from elsewhere, by `$name` or by a YAML alias.
    pub via: Option<Span>,
    /// Tagged `!replace`: takes the place of what it overrides instead of being merged into it.
    pub replace: bool,
}

/// What a [`Node`] is.
#[derive(Clone, Debug)]
pub(crate) enum Value {
    /// Nothing, or `null`.
    Null,
    /// `true` or `false`.
    Bool(bool),
    /// A finite number, with the text it was written as: the name of the value on an axis.
    Number(Number, Arc<str>),
    /// A text; `$` is not looked at yet.
    Text(Arc<str>),
    /// A list.
    List(Vec<Node>),
    /// A map, in the order of the file, without duplicate keys.
    Map(Vec<(Key, Node)>),
    /// Something unusable, which was reported: what is made from it is left alone.
    Broken,
}

/// A name with its place.
#[derive(Clone, Debug)]
pub(crate) struct Key {
    /// The name.
    pub text: Arc<str>,
    /// Where it stands.
    pub span: Span,
}

impl Node {
    /// A value of the file.
    pub fn new(value: Value, span: Span) -> Self {
        Self { value, span, via: None, replace: false }
    }

    /// The same, brought in at `via`.
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

    /// The text of a scalar as it goes into another text: as it was written, but for whole numbers in the notations that
    /// only YAML has (`0x1f`, `0o17`), which are given in decimal. `None` as with [`Node::scalar_text`].
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
