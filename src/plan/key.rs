//! The key of a stage: blake3 over canonical bytes of everything that its result depends on, and of nothing else.
//!
//! The bytes are written here and not by a serialiser, because another crate's feature flag can change the order in which a
//! serialiser writes a map. Every text and list is written with its length and every value with its type, so that no two
//! different stages have the same bytes. `docs/design/keys.md` describes the format; changing it makes every stored record
//! unreachable.

use std::collections::BTreeMap;

use dril_stage_api::Labels;
use serde_json::{Map, Number, Value};

use crate::store::{Digest, Key, Record};

/// Separates keys from every other use of blake3; contains the version of the format.
const CONTEXT: &str = "dril-pipe stage key v1";

/// Distinguishes an executable file from a data file with the same bytes.
const EXECUTABLE: &str = "dril-pipe executable v1";

/// A parameter that cannot enter a key.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error("`{path}` is {value}, expected a finite number of at most 64 bits")]
pub struct NoKey {
    /// The dotted path of the parameter.
    pub path: String,
    /// Its value.
    pub value: String,
}

/// Everything that the result of a stage depends on.
#[derive(Clone, Debug)]
pub struct KeyInputs<'a> {
    /// The kind's name.
    pub kind: &'a str,
    /// The kind's revision.
    pub revision: u32,
    /// Normalised parameters.
    pub params: &'a Value,
    /// The seed; `None` where the kind is not seeded.
    pub seed: Option<u64>,
    /// The artifacts of each input; the order of inputs does not matter.
    pub inputs: Vec<KeyInput<'a>>,
}

/// The artifacts of one input.
#[derive(Clone, Debug)]
pub struct KeyInput<'a> {
    /// The input's name.
    pub port: &'a str,
    /// True where the input takes many: then labels are part of the key.
    pub many: bool,
    /// Digests with their labels; the order matters. For an executable file, see [`executable`].
    pub items: Vec<(Digest, &'a Labels)>,
}

/// The digest that represents, in a key, an executable file with this content, where the stage can execute it.
pub fn executable(content: &Digest) -> Digest {
    Digest::new(blake3::derive_key(EXECUTABLE, content.as_bytes()))
}

impl KeyInputs<'_> {
    /// The key.
    ///
    /// # Errors
    /// A parameter is a number that is not finite or does not fit 64 bits.
    pub fn key(&self) -> Result<Key, NoKey> {
        let mut hasher = blake3::Hasher::new_derive_key(CONTEXT);
        hasher.update(&self.canonical_bytes()?);
        Ok(Key::new(*hasher.finalize().as_bytes()))
    }

    fn canonical_bytes(&self) -> Result<Vec<u8>, NoKey> {
        let mut out = Canonical(Vec::with_capacity(512));
        out.text(self.kind);
        out.number(u64::from(self.revision));
        out.value(self.params)?;
        match self.seed {
            None => out.tag(Tag::Absent),
            Some(seed) => {
                out.tag(Tag::Unsigned);
                out.number(seed);
            }
        }
        let mut inputs: Vec<&KeyInput<'_>> = self.inputs.iter().collect();
        inputs.sort_unstable_by_key(|input| input.port);
        out.length(inputs.len());
        for input in inputs {
            out.input(input);
        }
        Ok(out.0)
    }
}

/// The digest that represents a file in a key.
pub fn named(content: &Digest, is_executable: bool) -> Digest {
    if is_executable { executable(content) } else { *content }
}

/// The key of a record, computed from the inputs and parameters that it contains.
///
/// # Errors
/// The record contains a parameter that cannot enter a key.
pub fn key_of_record(record: &Record) -> Result<Key, NoKey> {
    let inputs = record.inputs.iter().map(|input| KeyInput {
        port: &input.port,
        many: input.many,
        items: input.items.iter().map(|item| (named(&item.digest, item.executable), &item.labels)).collect(),
    });
    let work = KeyInputs {
        kind: &record.kind,
        revision: record.revision,
        params: &record.params,
        seed: record.seed,
        inputs: inputs.collect(),
    };
    work.key()
}

/// The type tag before a value. The numbers are part of the format.
#[derive(Clone, Copy)]
#[repr(u8)]
enum Tag {
    Absent = 0,
    False = 1,
    True = 2,
    Unsigned = 3,
    Negative = 4,
    Float = 5,
    Text = 6,
    List = 7,
    Map = 8,
}

struct Canonical(Vec<u8>);

impl Canonical {
    fn tag(&mut self, tag: Tag) {
        self.0.push(tag as u8);
    }

    fn number(&mut self, number: u64) {
        self.0.extend_from_slice(&number.to_le_bytes());
    }

    fn length(&mut self, length: usize) {
        self.number(length as u64);
    }

    fn text(&mut self, text: &str) {
        self.length(text.len());
        self.0.extend_from_slice(text.as_bytes());
    }

    fn value(&mut self, value: &Value) -> Result<(), NoKey> {
        match value {
            Value::Null => self.tag(Tag::Absent),
            Value::Bool(false) => self.tag(Tag::False),
            Value::Bool(true) => self.tag(Tag::True),
            Value::Number(number) => self.json_number(number)?,
            Value::String(text) => {
                self.tag(Tag::Text);
                self.text(text);
            }
            Value::Array(list) => {
                self.tag(Tag::List);
                self.length(list.len());
                for (position, item) in list.iter().enumerate() {
                    self.value(item).map_err(|error| error.below(&position.to_string()))?;
                }
            }
            Value::Object(map) => self.map(map)?,
        }
        Ok(())
    }

    fn json_number(&mut self, number: &Number) -> Result<(), NoKey> {
        if let Some(unsigned) = number.as_u64() {
            self.tag(Tag::Unsigned);
            self.number(unsigned);
        } else if let Some(negative) = number.as_i64() {
            self.tag(Tag::Negative);
            self.number(negative.cast_unsigned());
        } else if let Some(float) = number.as_f64().filter(|float| float.is_finite()) {
            self.tag(Tag::Float);
            self.number(float.to_bits());
        } else {
            return Err(NoKey { path: String::new(), value: number.to_string() });
        }
        Ok(())
    }

    fn map(&mut self, map: &Map<String, Value>) -> Result<(), NoKey> {
        self.tag(Tag::Map);
        self.length(map.len());
        // Sorted already, unless a crate in the build switched on serde_json's `preserve_order`.
        let mut entries: Vec<(&String, &Value)> = map.iter().collect();
        entries.sort_unstable_by_key(|(name, _)| *name);
        for (name, item) in entries {
            self.text(name);
            self.value(item).map_err(|error| error.below(name))?;
        }
        Ok(())
    }

    fn input(&mut self, input: &KeyInput<'_>) {
        self.text(input.port);
        self.tag(if input.many { Tag::True } else { Tag::False });
        self.length(input.items.len());
        for (digest, labels) in &input.items {
            self.0.extend_from_slice(digest.as_bytes());
            if input.many {
                self.labels(labels);
            }
        }
    }

    fn labels(&mut self, labels: &BTreeMap<String, String>) {
        self.length(labels.len());
        for (axis, value) in labels {
            self.text(axis);
            self.text(value);
        }
    }
}

impl NoKey {
    fn below(mut self, name: &str) -> Self {
        self.path = if self.path.is_empty() { name.to_owned() } else { format!("{name}.{}", self.path) };
        self
    }
}

#[cfg(test)]
#[path = "key_tests.rs"]
mod tests;
