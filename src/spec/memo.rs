//! The memo of a pipeline file: the parsed stages by the digest of their text, so that only the changed ones are parsed after an
//! edit. Correctness does not depend on it: what is damaged or unknown is parsed from the text.
//!
//! Format: the digest of what follows; then for each stage the digest of its text, the length of its value, and the value with
//! every place relative to the start of the text. Numbers are little-endian.

use std::collections::HashMap;
use std::ops::Range;
use std::sync::Arc;

use super::node::{Key, MAX_DEPTH, Node, Value};
use super::scalar;
use super::source::Span;

/// The known stages, and those of this reading.
#[derive(Clone, Debug, Default)]
pub struct Memo {
    bytes: Vec<u8>,
    pub(super) known: HashMap<[u8; 32], Range<usize>>,
    /// The stages of this reading, in the format of [`Memo::bytes`].
    used: Vec<u8>,
    /// True where they differ from the known ones.
    news: bool,
}

/// The position of a text.
#[derive(Clone, Copy)]
pub(super) struct At {
    /// The number of its source.
    pub source: u16,
    /// Its first byte.
    pub start: usize,
}

impl Memo {
    /// Reads the bytes of [`Memo::bytes`]; an empty memo from anything else.
    pub fn read(bytes: Vec<u8>) -> Self {
        let known = entries(&bytes).unwrap_or_default();
        Self { bytes, known, ..Self::default() }
    }

    /// The memo for the next reading, if it changed.
    pub fn bytes(&self) -> Option<Vec<u8>> {
        let whole = || [blake3::hash(&self.used).as_bytes(), &*self.used].concat();
        self.news.then(whole)
    }

    /// The parsed value of the text with this digest.
    pub(super) fn get(&mut self, text: &[u8; 32], at: At) -> Option<(Key, Node)> {
        let range = self.known.get(text)?.clone();
        let mut reader = Reader { rest: self.bytes.get(range.clone())?, at };
        let entry = (reader.key()?, reader.node(0)?);
        if !reader.rest.is_empty() {
            return None;
        }
        put_entry(&mut self.used, text, &self.bytes[range]);
        Some(entry)
    }

    /// Adds the parsed value of a text.
    pub(super) fn keep(&mut self, text: &[u8; 32], at: At, (key, node): &(Key, Node)) {
        let mut writer = Writer { out: Vec::new(), at };
        if writer.key(key).and_then(|()| writer.node(node)).is_some() {
            put_entry(&mut self.used, text, &writer.out);
        }
        self.news = true;
    }

    /// Drops what was used after that: the file was parsed as a whole in the end.
    pub(super) fn forget(&mut self, used: usize) {
        self.used.truncate(used);
        self.news &= used > 0;
    }

    /// How much was used so far.
    pub(super) fn used(&self) -> usize {
        self.used.len()
    }
}

fn put_entry(out: &mut Vec<u8>, text: &[u8; 32], value: &[u8]) {
    out.extend_from_slice(text);
    number(out, value.len());
    out.extend_from_slice(value);
}

fn entries(bytes: &[u8]) -> Option<HashMap<[u8; 32], Range<usize>>> {
    let (digest, body) = bytes.split_first_chunk::<32>()?;
    if blake3::hash(body).as_bytes() != digest {
        return None;
    }
    let mut known = HashMap::new();
    let mut reader = Reader { rest: body, at: At { source: 0, start: 0 } };
    while !reader.rest.is_empty() {
        let (text, rest) = reader.rest.split_first_chunk::<32>()?;
        reader.rest = rest;
        let length = reader.number()?;
        let start = bytes.len() - reader.rest.len();
        reader.take(length)?;
        known.insert(*text, start..start + length);
    }
    Some(known)
}

/// Seven bits per byte, lowest first.
fn number(out: &mut Vec<u8>, mut number: usize) {
    while number >= 0x80 {
        out.push((number & 0x7f) as u8 | 0x80);
        number >>= 7;
    }
    out.push(number as u8);
}

/// Type tags of values; [`REPLACE`] is added for a value with that tag.
const NULL: u8 = 0;
const FALSE: u8 = 1;
const TRUE: u8 = 2;
const NUMBER: u8 = 3;
const TEXT: u8 = 4;
const LIST: u8 = 5;
const MAP: u8 = 6;
const REPLACE: u8 = 0x80;

struct Writer {
    out: Vec<u8>,
    at: At,
}

impl Writer {
    /// `None` for what cannot be stored, here and below.
    fn span(&mut self, span: Span) -> Option<()> {
        let start = (span.start as usize).checked_sub(self.at.start)?;
        let length = (span.end as usize).checked_sub(span.start as usize)?;
        number(&mut self.out, start);
        number(&mut self.out, length);
        (span.source == self.at.source).then_some(())
    }

    fn text(&mut self, text: &str) {
        number(&mut self.out, text.len());
        self.out.extend_from_slice(text.as_bytes());
    }

    fn key(&mut self, key: &Key) -> Option<()> {
        self.text(&key.text);
        self.span(key.span)
    }

    fn node(&mut self, node: &Node) -> Option<()> {
        let tag = match &node.value {
            Value::Null => NULL,
            Value::Bool(false) => FALSE,
            Value::Bool(true) => TRUE,
            Value::Number(..) => NUMBER,
            Value::Text(_) => TEXT,
            Value::List(_) => LIST,
            Value::Map(_) => MAP,
            Value::Broken => return None,
        };
        self.out.push(if node.replace { tag | REPLACE } else { tag });
        self.span(node.span)?;
        match &node.value {
            Value::Number(_, text) | Value::Text(text) => self.text(text),
            Value::List(items) => {
                number(&mut self.out, items.len());
                items.iter().try_for_each(|item| self.node(item))?;
            }
            Value::Map(entries) => {
                number(&mut self.out, entries.len());
                entries.iter().try_for_each(|(key, node)| self.key(key).and_then(|()| self.node(node)))?;
            }
            _ => {}
        }
        node.via.is_none().then_some(())
    }
}

struct Reader<'b> {
    rest: &'b [u8],
    at: At,
}

impl<'b> Reader<'b> {
    fn take(&mut self, length: usize) -> Option<&'b [u8]> {
        let (taken, rest) = self.rest.split_at_checked(length)?;
        self.rest = rest;
        Some(taken)
    }

    fn byte(&mut self) -> Option<u8> {
        let (byte, rest) = self.rest.split_first()?;
        self.rest = rest;
        Some(*byte)
    }

    fn number(&mut self) -> Option<usize> {
        let mut number = 0;
        for shift in (0..35).step_by(7) {
            let byte = self.byte()?;
            number |= usize::from(byte & 0x7f) << shift;
            if byte < 0x80 {
                return Some(number);
            }
        }
        None
    }

    fn span(&mut self) -> Option<Span> {
        let start = self.at.start + self.number()?;
        let end = start + self.number()?;
        Some(Span::new(self.at.source, start..end))
    }

    fn text(&mut self) -> Option<&'b str> {
        let length = self.number()?;
        std::str::from_utf8(self.take(length)?).ok()
    }

    fn key(&mut self) -> Option<Key> {
        let text = Arc::from(self.text()?);
        Some(Key { text, span: self.span()? })
    }

    fn node(&mut self, depth: usize) -> Option<Node> {
        if depth > MAX_DEPTH {
            return None;
        }
        let tag = self.byte()?;
        let span = self.span()?;
        let value = match tag & !REPLACE {
            NULL => Value::Null,
            FALSE => Value::Bool(false),
            TRUE => Value::Bool(true),
            NUMBER => scalar::read(self.text()?).ok().filter(|value| matches!(value, Value::Number(..)))?,
            TEXT => Value::Text(self.text()?.into()),
            LIST => {
                let count = self.count()?;
                Value::List((0..count).map(|_| self.node(depth + 1)).collect::<Option<_>>()?)
            }
            MAP => {
                let count = self.count()?;
                let mut entries = Vec::with_capacity(count.min(64));
                for _ in 0..count {
                    entries.push((self.key()?, self.node(depth + 1)?));
                }
                Value::Map(entries)
            }
            _ => return None,
        };
        Some(Node { replace: tag & REPLACE != 0, ..Node::new(value, span) })
    }

    /// A number of things that each take a byte at least.
    fn count(&mut self) -> Option<usize> {
        self.number().filter(|count| *count <= self.rest.len())
    }
}
