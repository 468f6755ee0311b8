//! From YAML text to a tree of [`Node`]s. The only file that knows the YAML crate's events.
//!
//! The event stream is read instead of deserialising into types: so every duplicate key is found, not only the first,
//! every value keeps its place, and what the text can make us build is bounded here: depth, copies by alias, documents.

use std::collections::HashMap;

use serde_saphyr::granit_parser::{self, Event, Parser, ScalarStyle, Tag};

use super::node::{Key, MAX_DEPTH, Node, UNUSABLE, Value};
use super::problem::{Problem, ProblemList};
use super::scalar;
use super::source::Span;
use super::syntax;

/// How many values aliases may copy in all; a file that needs more is an attack ("billion laughs").
const MAX_COPIES: usize = 100_000;

/// Reads the one document of `text`, which is source number `source` from byte `offset` on. `None` where there is no
/// tree to continue with, or no document; problems say which.
pub(crate) fn read(text: &str, source: u16, offset: usize, problems: &mut ProblemList) -> Option<Node> {
    let mut loader = Loader::new(source, offset, problems);
    loader.load(text)?;
    loader.root
}

/// Reads a part of a file, in which nothing is wrong and which copies nothing; `None` for any other.
pub(super) fn read_part(text: &str, source: u16, offset: usize) -> Option<Node> {
    let mut problems = ProblemList::default();
    let mut loader = Loader::new(source, offset, &mut problems);
    loader.load(text)?;
    let (root, copies) = (loader.root, loader.copies);
    root.filter(|_| copies == 0 && problems.reports() == 0)
}

/// A list or map that is not closed yet.
struct Frame {
    span: Span,
    anchor: usize,
    replace: bool,
    content: Content,
}

enum Content {
    List(Vec<Node>),
    Map { entries: Vec<(Key, Node)>, key: Option<Key> },
}

struct Loader<'p> {
    source: u16,
    offset: usize,
    problems: &'p mut ProblemList,
    stack: Vec<Frame>,
    anchors: HashMap<usize, Node>,
    copies: usize,
    documents: usize,
    root: Option<Node>,
}

impl<'p> Loader<'p> {
    fn new(source: u16, offset: usize, problems: &'p mut ProblemList) -> Self {
        let (stack, anchors) = (Vec::new(), HashMap::new());
        Self { source, offset, problems, stack, anchors, copies: 0, documents: 0, root: None }
    }

    /// Reads the text; `None` where reading cannot continue.
    fn load(&mut self, text: &str) -> Option<()> {
        let options = granit_parser::options! {
            emit_comments: false,
            flow_nesting_limit: MAX_DEPTH,
            block_nesting_limit: MAX_DEPTH,
        };
        for next in Parser::new_from_str_with_options(text, options) {
            let (event, span) = match next {
                Ok(next) => next,
                Err(error) => {
                    let at = error.marker().byte_offset().unwrap_or(text.len());
                    let at = syntax::culprit(error.kind(), text, at);
                    let at = self.offset + at;
                    let at = Span::new(self.source, at..at + 1);
                    self.problems.add(|| syntax::explain(error.kind(), at));
                    return None;
                }
            };
            self.event(event, span)?;
        }
        Some(())
    }

    fn span(&self, span: granit_parser::Span) -> Span {
        let range = span.byte_range().unwrap_or_default();
        Span::new(self.source, self.offset + range.start..self.offset + range.end)
    }

    /// Takes one event; `None` where reading cannot continue.
    fn event(&mut self, event: Event<'_>, at: granit_parser::Span) -> Option<()> {
        let span = self.span(at);
        match event {
            Event::DocumentStart(..) => self.document(span)?,
            Event::Scalar(text, style, anchor, tag) => {
                let value = match tag {
                    Some(tag) => self.foreign_tag(&tag, span),
                    None => self.scalar(&text, style, span),
                };
                self.attach(Node::new(value, span), anchor)?;
            }
            Event::SequenceStart(_, anchor, tag) => {
                self.open(span, anchor, tag.as_deref(), Content::List(Vec::new()))?;
            }
            Event::MappingStart(_, anchor, tag) => {
                self.open(span, anchor, tag.as_deref(), Content::Map { entries: Vec::new(), key: None })?;
            }
            Event::SequenceEnd | Event::MappingEnd => self.close(span)?,
            Event::Alias(id) => self.alias(id, span)?,
            _ => {}
        }
        Some(())
    }

    fn document(&mut self, span: Span) -> Option<()> {
        self.documents += 1;
        if self.documents > 1 {
            self.problems.add(|| {
                Problem::new(span, "found a second YAML document, expected one")
                    .label("begins here")
                    .hint("remove the `---` line, or put what follows it into a file of its own")
            });
            return None;
        }
        Some(())
    }

    fn scalar(&mut self, text: &str, style: ScalarStyle, span: Span) -> Value {
        if style != ScalarStyle::Plain {
            return Value::Text(text.into());
        }
        scalar::read(text).unwrap_or_else(|message| {
            self.problems.add(|| {
                Problem::new(span, message)
                    .hint("write a number that a parameter can hold, or put it in quotes if a text is meant")
            });
            Value::Broken
        })
    }

    /// True for `!replace`; other tags are reported.
    fn tag(&mut self, tag: Option<&Tag>, span: Span) -> bool {
        let replace = tag.is_some_and(|tag| tag.original() == "!replace");
        if let Some(tag) = tag.filter(|_| !replace) {
            self.foreign_tag(tag, span);
        }
        replace
    }

    fn foreign_tag(&mut self, tag: &Tag, span: Span) -> Value {
        let name = tag.original();
        self.problems.add(|| {
            Problem::new(span, format!("found the YAML tag `{}`, expected a plain value", super::node::shorten(&name)))
                .hint("remove the tag; a text that looks like a number is written in quotes")
                .hint("the only tag is `!replace` before a map or list, which then is not merged with what it overrides")
        });
        Value::Broken
    }

    fn open(&mut self, span: Span, anchor: usize, tag: Option<&Tag>, content: Content) -> Option<()> {
        if self.stack.len() >= MAX_DEPTH {
            self.too_deep(span);
            return None;
        }
        let replace = self.tag(tag, span);
        self.stack.push(Frame { span, anchor, replace, content });
        Some(())
    }

    fn too_deep(&mut self, span: Span) {
        self.problems.add(|| {
            Problem::new(span, format!("lists and maps are more than {MAX_DEPTH} deep here"))
                .hint("is a bracket missing?")
        });
    }

    fn close(&mut self, end: Span) -> Option<()> {
        let Frame { mut span, anchor, replace, content } = self.stack.pop()?;
        let value = match content {
            Content::List(items) => Value::List(items),
            Content::Map { entries, .. } => Value::Map(self.without_duplicates(entries)),
        };
        if self.is_flow(span) {
            span.end = end.end.max(span.end);
        } else if let Value::Map(entries) = &value
            && let Some((key, _)) = entries.first()
        {
            span = key.span;
        }
        self.attach(Node { replace, ..Node::new(value, span) }, anchor)
    }

    /// A flow collection's start is its bracket, one byte; a block's takes none.
    fn is_flow(&self, span: Span) -> bool {
        !span.is_empty()
    }

    fn without_duplicates(&mut self, entries: Vec<(Key, Node)>) -> Vec<(Key, Node)> {
        let mut first: HashMap<std::sync::Arc<str>, Span> = HashMap::with_capacity(entries.len());
        let mut kept = Vec::with_capacity(entries.len());
        for (key, node) in entries {
            match first.get(&key.text) {
                _ if &*key.text == UNUSABLE => kept.push((key, node)),
                Some(earlier) => self.problems.add(|| {
                    let name = super::node::shorten(&key.text);
                    Problem::new(key.span, format!("found the key `{name}` a second time in one map"))
                        .label("second")
                        .related(*earlier, "first")
                        .hint("remove one of the two, or rename it")
                }),
                None => {
                    first.insert(key.text.clone(), key.span);
                    kept.push((key, node));
                }
            }
        }
        kept
    }

    fn alias(&mut self, id: usize, span: Span) -> Option<()> {
        let Some(node) = self.anchors.get(&id) else {
            self.problems.add(|| {
                Problem::new(span, "found a YAML alias inside its own value")
                    .hint("a value cannot contain itself; remove the alias")
            });
            return None;
        };
        self.copies += node.size();
        if self.copies > MAX_COPIES {
            self.problems.add(|| {
                Problem::new(span, format!("YAML aliases copy more than {MAX_COPIES} values"))
                    .label("up to here")
                    .hint("name shared values under `params` and write `$name`; such a name is not copied when read")
            });
            return None;
        }
        if self.stack.len() + node.depth() > MAX_DEPTH {
            self.too_deep(span);
            return None;
        }
        let node = node.clone().brought_in(span);
        self.attach(node, 0)
    }

    /// Hands a finished value to the collection that contains it.
    fn attach(&mut self, node: Node, anchor: usize) -> Option<()> {
        if anchor != 0 {
            self.anchors.insert(anchor, node.clone());
        }
        let Some(frame) = self.stack.last_mut() else {
            self.root = Some(node);
            return Some(());
        };
        match &mut frame.content {
            Content::List(items) => items.push(node),
            Content::Map { entries, key } => match key.take() {
                Some(key) if &*key.text == UNUSABLE => {
                    entries.push((key, Node { value: Value::Broken, ..node.shell() }));
                }
                Some(key) => entries.push((key, node)),
                None => *key = Some(usable_key(node, self.problems)),
            },
        }
        Some(())
    }
}

fn usable_key(node: Node, problems: &mut ProblemList) -> Key {
    let text = node.scalar_text();
    let span = node.via.unwrap_or(node.span);
    if let Some(text) = text.filter(|text| &**text != UNUSABLE) {
        return Key { text, span };
    }
    problems.add(|| match node.value {
        Value::Text(_) => Problem::new(node.span, "found the YAML merge key `<<`, expected a name")
            .hint("fields that stages share belong under `defaults`, or in a map under `params` used as `with: $name`"),
        _ => Problem::new(node.span, format!("found {} as a key, expected a name", node.describe()))
            .hint("a text with `{`, `[` or `*` in front is written in quotes"),
    });
    Key { text: UNUSABLE.into(), span }
}
