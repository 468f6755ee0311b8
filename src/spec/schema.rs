//! The JSON Schema of pipeline files, for editors: generated from the keys of the language and the parameters of the kinds, so that
//! it is always complete.
//!
//! Everything that it rejects is invalid; what it accepts can still be invalid, since names, references and ranges need the whole
//! file. It describes values as they are written: `$name` is allowed in place of any value, and a required field may come from
//! `defaults` or a profile.

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
        // Nothing is required: a file that is included may lack any of them.
        "$defs": defs,
    })
}

fn top_field(name: &str, registry: &Registry) -> Value {
    let anything = json!({ "type": ["object", "null"], "propertyNames": identifier() });
    match name {
        "name" => json!({
            "type": "string", "pattern": "^[a-z0-9]+(-[a-z0-9]+)*$",
            "description": "lower-case words with `-` between them; also the name of the results folder",
        }),
        "include" => json!({
            "description": "other files whose stages, axes and params are shared",
            "anyOf": [path(), { "type": "array", "items": path() }],
        }),
        "seed" => seed("the seed of every stage without its own"),
        "params" => about(anything, "shared values, used as `$name`"),
        "axes" => json!({
            "description": "the variables of the experiment, each with a list of values", "type": ["object", "null"],
            "propertyNames": identifier(), "additionalProperties": { "type": ["array", "object", "string"] },
        }),
        "defaults" => about(defaults(registry), "shared parameters and inputs of all stages of a kind"),
        "stages" => json!({
            "description": "the stages", "type": ["object", "null"],
            "propertyNames": { "allOf": [identifier(), { "not": { "enum": names::RESERVED_STAGES } }] },
            "additionalProperties": { "$ref": format!("{HERE}stage") },
        }),
        "profiles" => json!({
            "description": "named sets of overrides; the first one is the default",
            "type": ["object", "null"], "propertyNames": identifier(),
            "additionalProperties": {
                "type": ["object", "null"],
                "properties": {
                    "seed": seed("the pipeline's seed"), "params": anything, "axes": anything,
                    "defaults": defaults(registry),
                },
                "additionalProperties": { "anyOf": [reference(), { "type": ["object", "null"] }] },
            },
        }),
        _ => json!(true),
    }
}

fn defaults(registry: &Registry) -> Value {
    let of = |kind: &Kind| {
        let fields = json!({
            "type": ["object", "null"], "additionalProperties": false,
            "properties": { "with": with(kind), "inputs": inputs() },
        });
        (kind.name().to_owned(), fields)
    };
    let kinds: Map<String, Value> = registry.iter().map(of).collect();
    json!({ "type": ["object", "null"], "properties": kinds, "additionalProperties": false })
}

fn stage(registry: &Registry) -> Value {
    let fields = STAGE.iter().map(|name| ((*name).to_owned(), stage_field(name, registry)));
    let of_kind = |kind: &Kind| {
        json!({
            "if": { "properties": { "kind": { "const": kind.name() } }, "required": ["kind"] },
            "then": { "properties": { "with": with(kind) } },
        })
    };
    json!({
        "type": "object", "required": ["kind"], "additionalProperties": false,
        "properties": fields.collect::<Map<_, _>>(),
        "allOf": registry.iter().map(of_kind).collect::<Vec<_>>(),
    })
}

/// The parameters of a kind, as the whole value of `with`.
fn with(kind: &Kind) -> Value {
    json!({ "anyOf": [reference(), { "type": "null" }, { "$ref": format!("{HERE}{}", kind.name()) }] })
}

fn stage_field(name: &str, registry: &Registry) -> Value {
    match name {
        "kind" => {
            let kinds =
                registry.iter().map(|kind| json!({ "const": kind.name(), "description": kind.about() }));
            json!({ "description": "the stage kind", "oneOf": kinds.collect::<Vec<_>>() })
        }
        "about" => json!({ "type": "string", "description": "a description for readers; ignored" }),
        "matrix" => json!({
            "type": ["array", "object", "null"], "items": { "type": ["string", "object"] },
            "description": "the stage has one instance per combination of these axes",
        }),
        "when" => json!({
            "type": ["object", "array", "null"],
            "description": "only instances that match one of these maps exist",
        }),
        "seed" => seed("this stage's own seed"),
        "with" => json!({ "type": ["object", "null", "string"], "description": "parameters of the kind" }),
        "inputs" => inputs(),
        "retries" => json!({
            "description": "number of retries after a failure",
            "anyOf": [{ "type": "integer", "minimum": 0, "maximum": 1000 }, {
                "type": "object", "additionalProperties": false,
                "properties": { "times": { "type": "integer", "minimum": 0 }, "pause": { "type": "string" } },
            }],
        }),
        "timeout" => {
            json!({ "type": "string", "description": "time limit of one try, as `90s`, `2h`" })
        }
        "resources" => json!({
            "type": "object", "additionalProperties": { "type": "integer", "minimum": 1 },
            "description": "units of counted resources that it holds while it runs (`run --resources`), as `{ gpu: 1 }`",
        }),
        "memory" => json!({
            "type": "string", "description": "memory limit, as `500M`, `8G`",
        }),
        _ => json!(true),
    }
}

fn inputs() -> Value {
    json!({
        "description": "the inputs: references to stages, or files", "type": ["object", "null"], "additionalProperties": { "$ref": format!("{HERE}wiring") },
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

/// A text that contains a `$name`.
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
    // Editors show what is beside the alternatives.
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
