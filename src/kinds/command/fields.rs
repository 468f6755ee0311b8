//! Fields of a command that have several notations.

use std::borrow::Cow;
use std::collections::BTreeMap;
use std::path::{Component, Path};

use dril_stage_api::Artifact;
use schemars::{JsonSchema, Schema, SchemaGenerator, json_schema};
use serde::{Deserialize, Deserializer, Serialize, de};

use super::super::import::is_ending;

/// A word of a command line: a text; numbers, `true` and `false` are taken as text.
#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
#[serde(transparent)]
pub struct Word(pub(super) String);

struct WordVisitor;

impl de::Visitor<'_> for WordVisitor {
    type Value = Word;

    fn expecting(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.write_str("a text or a number")
    }

    fn visit_str<E: de::Error>(self, text: &str) -> Result<Word, E> {
        Ok(Word(text.to_owned()))
    }

    fn visit_bool<E: de::Error>(self, value: bool) -> Result<Word, E> {
        Ok(Word(value.to_string()))
    }

    fn visit_u64<E: de::Error>(self, value: u64) -> Result<Word, E> {
        Ok(Word(value.to_string()))
    }

    fn visit_i64<E: de::Error>(self, value: i64) -> Result<Word, E> {
        Ok(Word(value.to_string()))
    }

    fn visit_f64<E: de::Error>(self, value: f64) -> Result<Word, E> {
        Ok(Word(value.to_string()))
    }
}

impl<'de> Deserialize<'de> for Word {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        deserializer.deserialize_any(WordVisitor)
    }
}

struct WordsVisitor;

impl<'de> de::Visitor<'de> for WordsVisitor {
    type Value = Option<Vec<Word>>;

    fn expecting(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.write_str("a list, as in `[echo, hello]`; a command line for the shell is written as `shell: ...`")
    }

    fn visit_unit<E: de::Error>(self) -> Result<Self::Value, E> {
        Ok(None)
    }

    fn visit_seq<A: de::SeqAccess<'de>>(self, mut items: A) -> Result<Self::Value, A::Error> {
        let mut words = Vec::new();
        while let Some(word) = items.next_element()? {
            words.push(word);
        }
        Ok(Some(words))
    }
}

/// Reads the words of a command line.
pub(super) fn words<'de, D: Deserializer<'de>>(deserializer: D) -> Result<Option<Vec<Word>>, D::Error> {
    deserializer.deserialize_any(WordsVisitor)
}

impl JsonSchema for Word {
    fn schema_name() -> Cow<'static, str> {
        "Word".into()
    }

    fn json_schema(_: &mut SchemaGenerator) -> Schema {
        json_schema!({ "type": ["string", "number", "boolean"] })
    }
}

/// An input of a command.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize)]
pub struct CommandInput {
    #[serde(skip_serializing_if = "Option::is_none")]
    pub(super) path: Option<String>,
    #[serde(rename = "type", skip_serializing_if = "Option::is_none")]
    pub(super) artifact: Option<Artifact>,
    #[serde(skip_serializing_if = "is_false")]
    pub(super) many: bool,
    #[serde(skip_serializing_if = "is_false")]
    pub(super) optional: bool,
}

impl CommandInput {
    /// Its type: as given, `folder` if the path ends with `/`, else `any`.
    pub(super) fn artifact(&self) -> Artifact {
        let folder = !self.many && self.path.as_deref().is_some_and(|path| path.ends_with('/'));
        self.artifact.unwrap_or(if folder { Artifact::FOLDER } else { Artifact::ANY })
    }

    /// One notation for each meaning: without path and type where they are the default, a folder with a `/` after its path.
    pub(super) fn unify(&mut self, name: &str) {
        let artifact = self.artifact();
        let path = self.path.take().map(|path| normal(&path)).filter(|path| *path != default_input(name));
        (self.path, self.artifact) = match (path, artifact) {
            (path, Artifact::ANY) => (path, None),
            (Some(path), Artifact::FOLDER) if !self.many => (Some(path + "/"), None),
            (path, artifact) => (path, Some(artifact)),
        };
    }
}

/// The default path of an input.
pub(super) fn default_input(name: &str) -> String {
    format!("inputs/{name}")
}

/// An output of a command.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize)]
pub struct CommandOutput {
    #[serde(skip_serializing_if = "Option::is_none")]
    pub(super) path: Option<String>,
    #[serde(rename = "type", skip_serializing_if = "Option::is_none")]
    pub(super) artifact: Option<Artifact>,
}

impl CommandOutput {
    /// Its type: as given, `folder` if the path ends with `/`, else `file`.
    pub(super) fn artifact(&self) -> Artifact {
        let folder = self.path.as_deref().is_some_and(|path| path.ends_with('/'));
        self.artifact.unwrap_or(if folder { Artifact::FOLDER } else { Artifact::FILE })
    }

    /// The file extension, without the dot.
    pub(super) fn extension(&self) -> &str {
        let ending = self.path.as_deref().and_then(|path| Path::new(path).extension()?.to_str());
        match self.artifact() {
            Artifact::FOLDER => "",
            artifact => ending.filter(|ending| is_ending(ending)).unwrap_or(artifact.extension()),
        }
    }

    /// The default path.
    pub(super) fn default_path(&self, name: &str) -> String {
        match self.artifact() {
            Artifact::FOLDER => format!("outputs/{name}"),
            artifact => format!("outputs/{name}.{}", artifact.extension()),
        }
    }

    /// As [`CommandInput::unify`].
    pub(super) fn unify(&mut self, name: &str) {
        let artifact = self.artifact();
        let default = Self { path: None, artifact: Some(artifact) }.default_path(name);
        let path = self.path.take().map(|path| normal(&path)).filter(|path| *path != default);
        (self.path, self.artifact) = match (path, artifact) {
            (path, Artifact::FILE) => (path, None),
            (Some(path), Artifact::FOLDER) => (Some(path + "/"), None),
            (path, artifact) => (path, Some(artifact)),
        };
    }
}

fn is_false(value: &bool) -> bool {
    !value
}

/// The map notation. A type of its own, so that an unknown field is reported as such.
#[derive(Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
struct InputMap {
    /// Its path in the working folder; by default `inputs/<name>`.
    #[serde(default)]
    path: Option<String>,
    /// Its artifact type; by default `any`.
    #[serde(default, rename = "type")]
    artifact: Option<Artifact>,
    /// Takes one or more artifacts, in a folder as `0`, `1`, ...; `inputs.json` has their labels.
    #[serde(default)]
    many: bool,
    /// Can be omitted.
    #[serde(default)]
    optional: bool,
}

#[derive(Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
struct OutputMap {
    /// Its path in the working folder; by default `outputs/<name>.<extension>`.
    #[serde(default)]
    path: Option<String>,
    /// Its artifact type; by default `file`, or `folder` if the path ends with `/`.
    #[serde(default, rename = "type")]
    artifact: Option<Artifact>,
}

/// Reads a path, or a map with more.
macro_rules! path_or_map {
    ($type:ident, $map:ident, $schema:literal, $from:expr) => {
        impl<'de> Deserialize<'de> for $type {
            fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
                struct Visitor;
                impl<'de> de::Visitor<'de> for Visitor {
                    type Value = $type;
                    fn expecting(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
                        f.write_str("a path, or a map of fields")
                    }
                    fn visit_unit<E: de::Error>(self) -> Result<$type, E> {
                        Ok($type::default())
                    }
                    fn visit_str<E: de::Error>(self, path: &str) -> Result<$type, E> {
                        Ok($type { path: Some(path.to_owned()), ..$type::default() })
                    }
                    fn visit_map<A: de::MapAccess<'de>>(self, map: A) -> Result<$type, A::Error> {
                        $map::deserialize(de::value::MapAccessDeserializer::new(map)).map($from)
                    }
                }
                deserializer.deserialize_any(Visitor)
            }
        }

        impl JsonSchema for $type {
            fn schema_name() -> Cow<'static, str> {
                $schema.into()
            }
            fn json_schema(generator: &mut SchemaGenerator) -> Schema {
                let map = generator.subschema_for::<$map>();
                json_schema!({ "anyOf": [{ "type": ["string", "null"] }, map] })
            }
        }
    };
}

path_or_map!(CommandInput, InputMap, "CommandInput", |map: InputMap| CommandInput {
    path: map.path,
    artifact: map.artifact,
    many: map.many,
    optional: map.optional,
});
path_or_map!(CommandOutput, OutputMap, "CommandOutput", |map: OutputMap| CommandOutput {
    path: map.path,
    artifact: map.artifact,
});

/// Environment variables: a list of names, or a map. `None` is filled in from the environment of the run, and stays `None` if the
/// variable is not set there.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize)]
#[serde(transparent)]
pub struct Variables(pub(super) BTreeMap<String, Option<String>>);

impl Variables {
    pub(super) fn is_empty(&self) -> bool {
        self.0.is_empty()
    }

    /// The value of a variable, where it has one.
    pub(super) fn value(&self, name: &str) -> Option<&str> {
        self.0.get(name)?.as_deref()
    }

    /// The values that are known.
    pub(super) fn values(&self) -> impl Iterator<Item = &str> {
        self.0.values().flatten().map(String::as_str)
    }
}

impl<'de> Deserialize<'de> for Variables {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        struct Visitor;
        impl<'de> de::Visitor<'de> for Visitor {
            type Value = Variables;
            fn expecting(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
                f.write_str("a list of names, or a map of names and values")
            }
            fn visit_seq<A: de::SeqAccess<'de>>(self, mut list: A) -> Result<Variables, A::Error> {
                let mut all = BTreeMap::new();
                while let Some(name) = list.next_element::<String>()? {
                    all.insert(name, None);
                }
                Ok(Variables(all))
            }
            fn visit_map<A: de::MapAccess<'de>>(self, mut map: A) -> Result<Variables, A::Error> {
                let mut all = BTreeMap::new();
                while let Some((name, value)) = map.next_entry::<String, Option<Word>>()? {
                    all.insert(name, value.map(|word| word.0));
                }
                Ok(Variables(all))
            }
        }
        deserializer.deserialize_any(Visitor)
    }
}

impl JsonSchema for Variables {
    fn schema_name() -> Cow<'static, str> {
        "Variables".into()
    }

    fn json_schema(_: &mut SchemaGenerator) -> Schema {
        json_schema!({
            "anyOf": [
                { "type": "array", "items": { "type": "string" } },
                { "type": "object", "additionalProperties": { "type": ["string", "number", "boolean", "null"] } },
            ]
        })
    }
}

/// Removes `./` and double or trailing `/` from a path; other errors stay.
pub(super) fn normal(path: &str) -> String {
    let parts: Vec<&str> = path.split('/').filter(|part| !part.is_empty() && *part != ".").collect();
    if path.starts_with('/') { format!("/{}", parts.join("/")) } else { parts.join("/") }
}

/// True for a path that stays below the folder that it is relative to.
pub(super) fn is_inside(path: &str) -> bool {
    !path.is_empty()
        && !path.contains('\0')
        && Path::new(path).components().all(|part| matches!(part, Component::Normal(_)))
}
