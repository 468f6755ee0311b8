//! The JSON Schema of a pipeline file, for editors: made from the names that the reader of the file knows and from the
//! parameters of the kinds, so that neither can be forgotten.
//!
//! What it refuses is wrong; what it accepts may be wrong still, since names, wiring and ranges need the whole file.
//! It speaks of values as they are written: `$name` may stand in place of every one, and a field that a kind needs may
//! come from `defaults` or a profile.

use dril_stage_api::{Kind, Registry};
use serde_json::{Map, Value, json};

use super::decode::{STAGE, TOP};
use super::names;

/// Where the definitions lie.
const HERE: &str = "#/$defs/";

/// The schema of a pipeline file of these kinds.
pub fn schema(registry: &Registry) -> Value {
    let mut defs = Map::new();
    defs.insert("stage".to_owned(), stage(registry));
    defs.insert("wiring".to_owned(), wiring());
    for kind in registry.iter() {
        let schema = kind.schema().to_value();
        for (name, part) in schema["$defs"].as_object().into_iter().flatten() {
            defs.insert(format!("{}.{name}", kind.name()), written(part, kind, true));
        }
        defs.insert(kind.name().to_owned(), written(&schema, kind, true));
    }
    let top = TOP.iter().map(|name| ((*name).to_owned(), top_field(name, registry)));
    json!({
        "$schema": "https://json-schema.org/draft/2020-12/schema",
        "title": "pipeline file of dril-pipe",
        "type": "object",
        "properties": top.collect::<Map<_, _>>(),
        "additionalProperties": false,
        // A file that is included, or that includes others, may lack any of them.
        "anyOf": [{ "required": ["name", "stages"] }, { "required": ["include"] }, { "not": { "required": ["name"] } }],
        "$defs": defs,
    })
}

fn top_field(name: &str, registry: &Registry) -> Value {
    let anything = json!({ "type": ["object", "null"], "propertyNames": identifier() });
    match name {
        "name" => json!({
            "type": "string", "pattern": "^[a-z0-9]+(-[a-z0-9]+)*$",
            "description": "lower case words with `-` between them; results go to a folder of that name",
        }),
        "include" => json!({
            "description": "other files whose stages, axes and params are shared",
            "anyOf": [path(), { "type": "array", "items": path() }],
        }),
        "seed" => seed("the seed of every stage that names none"),
        "params" => about(anything, "shared values, used as `$name`"),
        "axes" => json!({
            "description": "what the experiment varies", "type": ["object", "null"],
            "propertyNames": identifier(), "additionalProperties": { "type": ["array", "object", "string"] },
        }),
        "defaults" => about(defaults(registry), "what all stages of a kind share"),
        "stages" => json!({
            "description": "the stages", "type": ["object", "null"],
            "propertyNames": { "allOf": [identifier(), { "not": { "enum": names::RESERVED_STAGES } }] },
            "additionalProperties": { "$ref": format!("{HERE}stage") },
        }),
        "profiles" => json!({
            "description": "named sets of changes; the first holds when none is chosen",
            "type": ["object", "null"], "propertyNames": identifier(),
            "additionalProperties": {
                "type": ["object", "null"],
                "properties": {
                    "seed": seed("the pipeline's seed"), "params": anything, "axes": anything,
                    "defaults": defaults(registry),
                },
                "additionalProperties": { "type": ["object", "null"] },
            },
        }),
        _ => json!(true),
    }
}

fn defaults(registry: &Registry) -> Value {
    let of = |kind: &Kind| {
        let fields = json!({
            "type": ["object", "null"], "additionalProperties": false,
            "properties": { "with": { "$ref": format!("{HERE}{}", kind.name()) }, "inputs": inputs() },
        });
        (kind.name().to_owned(), fields)
    };
    let kinds: Map<String, Value> = registry.iter().map(of).collect();
    json!({ "type": ["object", "null"], "properties": kinds, "additionalProperties": false })
}

fn stage(registry: &Registry) -> Value {
    let fields = STAGE.iter().map(|name| ((*name).to_owned(), stage_field(name, registry)));
    let with = |kind: &Kind| {
        json!({
            "if": { "properties": { "kind": { "const": kind.name() } }, "required": ["kind"] },
            "then": { "properties": { "with": { "$ref": format!("{HERE}{}", kind.name()) } } },
        })
    };
    json!({
        "type": "object", "required": ["kind"], "additionalProperties": false,
        "properties": fields.collect::<Map<_, _>>(),
        "allOf": registry.iter().map(with).collect::<Vec<_>>(),
    })
}

fn stage_field(name: &str, registry: &Registry) -> Value {
    match name {
        "kind" => {
            let kinds =
                registry.iter().map(|kind| json!({ "const": kind.name(), "description": kind.about() }));
            json!({ "description": "what it does", "oneOf": kinds.collect::<Vec<_>>() })
        }
        "about" => json!({ "type": "string", "description": "for readers; means nothing" }),
        "matrix" => json!({
            "type": ["array", "object", "null"], "items": { "type": ["string", "object"] },
            "description": "one instance for each combination of these axes",
        }),
        "when" => json!({
            "type": ["object", "array", "null"],
            "description": "lets those instances through for which one of its maps holds",
        }),
        "seed" => seed("this stage's own seed"),
        "with" => json!({ "type": ["object", "null", "string"], "description": "parameters of the kind" }),
        "inputs" => inputs(),
        "retries" => json!({
            "description": "tries after a failure",
            "anyOf": [{ "type": "integer", "minimum": 0, "maximum": 1000 }, {
                "type": "object", "additionalProperties": false,
                "properties": { "times": { "type": "integer", "minimum": 0 }, "pause": { "type": ["string", "number"] } },
            }],
        }),
        "timeout" => {
            json!({ "type": ["string", "number"], "description": "how long one try may take, as `90s`, `2h`" })
        }
        "resources" => json!({
            "type": "object", "additionalProperties": { "type": "integer", "minimum": 1 },
            "description": "what it holds while it runs, of what `run --resources` counts, as `{ gpu: 1 }`",
        }),
        "memory" => json!({
            "type": ["string", "number"], "description": "how much memory it may keep, as `500M`, `8G`",
        }),
        _ => json!(true),
    }
}

fn inputs() -> Value {
    json!({
        "description": "what it reads", "type": ["object", "null"], "additionalProperties": { "$ref": format!("{HERE}wiring") },
    })
}

/// Where an artifact comes from.
fn wiring() -> Value {
    let one = json!({ "type": ["string", "object", "null"] });
    json!({ "anyOf": [one, { "type": "array", "items": one }] })
}

fn identifier() -> Value {
    json!({ "pattern": "^[A-Za-z][A-Za-z0-9_-]*$" })
}

fn path() -> Value {
    json!({ "type": "string", "minLength": 1 })
}

fn seed(text: &str) -> Value {
    about(json!({ "anyOf": [{ "type": "integer", "minimum": 0 }, reference()] }), text)
}

/// A text in which `$name` stands for something.
fn reference() -> Value {
    json!({ "type": "string", "pattern": "\\$" })
}

fn about(mut schema: Value, text: &str) -> Value {
    schema["description"] = json!(text);
    schema
}

/// The schema of a value as it is written in the file. `whole`: not one of several alternatives.
fn written(schema: &Value, kind: &Kind, whole: bool) -> Value {
    let Value::Object(fields) = schema else { return schema.clone() };
    let mut new = Map::new();
    for (word, value) in fields {
        let value = match (word.as_str(), value) {
            ("$schema" | "$defs" | "title" | "format", _) => continue,
            // What is missing here may come from elsewhere; the one name of an alternative is what tells it.
            ("required", _) if whole => continue,
            ("$ref", Value::String(target)) => {
                json!(format!("{HERE}{}.{}", kind.name(), target.trim_start_matches(HERE)))
            }
            ("properties", Value::Object(properties)) => {
                let properties =
                    properties.iter().map(|(name, value)| (name.clone(), or_reference(value, kind)));
                Value::Object(properties.collect())
            }
            ("items" | "additionalProperties", Value::Object(_)) => or_reference(value, kind),
            ("oneOf" | "anyOf" | "allOf", Value::Array(choices)) => {
                choices.iter().map(|choice| written(choice, kind, false)).collect()
            }
            (_, value) => value.clone(),
        };
        // A reference may fit several alternatives.
        new.insert(if word == "oneOf" { "anyOf".to_owned() } else { word.clone() }, value);
    }
    Value::Object(new)
}

fn or_reference(schema: &Value, kind: &Kind) -> Value {
    let mut value = written(schema, kind, true);
    let mut either = json!({ "anyOf": [reference()] });
    // Editors show what stands beside the alternatives.
    for word in ["description", "default"] {
        if let Some(text) = value.as_object_mut().and_then(|fields| fields.remove(word)) {
            either[word] = text;
        }
    }
    if let Some(choices) = either["anyOf"].as_array_mut() {
        choices.push(value);
    }
    either
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::kinds::KINDS;

    #[test]
    fn every_key_of_the_language_has_a_schema() {
        let schema = schema(&Registry::new(KINDS.to_vec()).unwrap());
        for name in TOP {
            assert!(schema["properties"][name].is_object(), "{name}");
        }
        for name in STAGE {
            assert!(schema["$defs"]["stage"]["properties"][name].is_object(), "{name}");
        }
    }
}
