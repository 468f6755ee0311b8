//! Formats a JSON Schema for people: one line per field. Supports the subset that derived schemas use.

use serde_json::{Map, Value, json};

/// The maximum depth of nested fields (a schema may refer to itself).
const DEEPEST: usize = 6;

/// One field of the parameters.
#[derive(Debug, PartialEq, Eq)]
pub(super) struct Field {
    /// Dotted, from `with:`.
    pub path: String,
    /// Its type, or the allowed values.
    pub accepts: String,
    /// Its default as YAML, `required`, or `optional`.
    pub default: String,
    /// Its description.
    pub about: String,
}

/// The fields of a schema, required ones first, those of maps below them.
pub(super) fn fields(root: &Value) -> Vec<Field> {
    let mut found = Vec::new();
    collect(root, root, "", DEEPEST, &mut found);
    found
}

fn collect(root: &Value, schema: &Value, prefix: &str, depth: usize, found: &mut Vec<Field>) {
    let schema = follow(root, schema);
    let Some(properties) = schema["properties"].as_object() else {
        for choice in choices(schema) {
            if depth > 0 {
                collect(root, choice, prefix, depth - 1, found);
            }
        }
        return;
    };
    let required = |name: &str| {
        schema["required"].as_array().is_some_and(|names| names.iter().any(|required| required == name))
    };
    let mut names: Vec<&String> = properties.keys().collect();
    names.sort_by_key(|name| !required(name));
    for name in names {
        let property = &properties[name];
        let path = if prefix.is_empty() { name.clone() } else { format!("{prefix}.{name}") };
        let default = match property.get("default") {
            Some(Value::Null) => "optional".to_owned(),
            Some(value) => default_text(value),
            None if required(name) => "required".to_owned(),
            None => "optional".to_owned(),
        };
        let accepts = accepts(root, property, DEEPEST);
        found.push(Field { path: path.clone(), accepts, default, about: about(root, property) });
        if depth > 0 {
            collect(root, property, &path, depth - 1, found);
        }
    }
}

/// Formats a value as YAML: a plain word without quotes.
fn default_text(value: &Value) -> String {
    match value.as_str() {
        Some(word) if !word.is_empty() && word.chars().all(|c| c.is_alphanumeric() || "-_".contains(c)) => {
            word.to_owned()
        }
        _ => value.to_string(),
    }
}

/// The schema, or the schema that it refers to.
fn follow<'a>(root: &'a Value, schema: &'a Value) -> &'a Value {
    let target = schema["$ref"].as_str().and_then(|target| target.strip_prefix('#'));
    target.and_then(|pointer| root.pointer(pointer)).unwrap_or(schema)
}

fn choices(schema: &Value) -> impl Iterator<Item = &Value> {
    ["oneOf", "anyOf"].into_iter().filter_map(|word| schema[word].as_array()).flatten()
}

fn about(root: &Value, property: &Value) -> String {
    let own = property["description"].as_str();
    let text = own.or_else(|| follow(root, property)["description"].as_str()).unwrap_or_default();
    text.split_whitespace().collect::<Vec<_>>().join(" ")
}

fn accepts(root: &Value, schema: &Value, depth: usize) -> String {
    let schema = follow(root, schema);
    if depth == 0 {
        return "…".to_owned();
    }
    if let Some(value) = schema.get("const") {
        return plain(value);
    }
    if let Some(values) = schema["enum"].as_array() {
        return values.iter().map(plain).collect::<Vec<_>>().join(" | ");
    }
    let words: Vec<String> = choices(schema)
        .map(|choice| accepts(root, choice, depth - 1))
        .filter(|word| word != "null")
        .collect();
    if !words.is_empty() {
        return words.join(" | ");
    }
    match &schema["type"] {
        Value::String(name) => of_type(root, schema, name, depth),
        Value::Array(names) => {
            let names = names.iter().filter_map(Value::as_str).filter(|name| *name != "null");
            names.map(|name| of_type(root, schema, name, depth)).collect::<Vec<_>>().join(" | ")
        }
        _ => "any".to_owned(),
    }
}

fn of_type(root: &Value, schema: &Value, name: &str, depth: usize) -> String {
    match name {
        "array" => match schema.get("items") {
            Some(items) => format!("list of {}", accepts(root, items, depth - 1)),
            None => "list".to_owned(),
        },
        "object" => match schema["properties"].as_object() {
            // A choice written as a map with one field that must be there, as `{ car-racing: … }`.
            Some(fields) if fields.len() == 1 && schema["required"].is_array() => {
                format!("{{ {}: … }}", fields.keys().next().map_or("", String::as_str))
            }
            _ => "map".to_owned(),
        },
        other => other.to_owned(),
    }
}

fn plain(value: &Value) -> String {
    value.as_str().map_or_else(|| value.to_string(), str::to_owned)
}

/// A value that the schema accepts, with the required fields only; ranges that it does not tell are not kept.
pub(super) fn sample(root: &Value) -> Value {
    sample_of(root, root, DEEPEST)
}

fn sample_of(root: &Value, schema: &Value, depth: usize) -> Value {
    if let Some(default) = schema.get("default") {
        return default.clone();
    }
    let schema = follow(root, schema);
    if depth == 0 {
        return Value::Null;
    }
    let listed = schema["enum"].as_array().and_then(|values| values.first());
    if let Some(value) = schema.get("const").or(listed) {
        return value.clone();
    }
    if let Some(choice) = choices(schema).next() {
        return sample_of(root, choice, depth - 1);
    }
    let name = match &schema["type"] {
        Value::Array(names) => names.first().and_then(Value::as_str),
        name => name.as_str(),
    };
    match name {
        Some("integer") => json!(schema["minimum"].as_i64().unwrap_or(0).max(1)),
        Some("number") => json!(schema["minimum"].as_f64().unwrap_or(0.0).max(1.0)),
        Some("string") => json!("x"),
        Some("boolean") => json!(false),
        Some("array") => json!([]),
        Some("object") => required_fields(root, schema, depth),
        _ => Value::Null,
    }
}

fn required_fields(root: &Value, schema: &Value, depth: usize) -> Value {
    let names = schema["required"].as_array().into_iter().flatten().filter_map(Value::as_str);
    let fields: Map<String, Value> = names
        .map(|name| (name.to_owned(), sample_of(root, &schema["properties"][name], depth - 1)))
        .collect();
    Value::Object(fields)
}

#[cfg(test)]
mod tests {
    use super::*;
    use schemars::JsonSchema;
    use serde::Deserialize;

    /// A world.
    #[derive(Deserialize, JsonSchema)]
    #[serde(rename_all = "kebab-case")]
    #[allow(dead_code, reason = "read by the schema alone")]
    enum World {
        CarRacing {
            /// Steps until it ends.
            #[serde(default)]
            time_limit: u32,
        },
    }
    #[derive(Deserialize, JsonSchema)]
    #[serde(rename_all = "kebab-case")]
    #[allow(dead_code, reason = "read by the schema alone")]
    enum Shape {
        Gaussian,
        Beta,
    }
    #[derive(Deserialize, JsonSchema)]
    #[allow(dead_code, reason = "read by the schema alone")]
    struct Params {
        /// The world.
        env: World,
        /// The
        /// shape.
        shape: Shape,
        #[serde(default)]
        rate: f64,
        limit: Option<u32>,
        layers: Vec<u32>,
    }

    fn root() -> Value {
        schemars::schema_for!(Params).to_value()
    }

    #[test]
    fn every_field_is_listed_with_type_default_and_words() {
        let lines: Vec<String> = fields(&root())
            .into_iter()
            .map(|field| format!("{} / {} / {} / {}", field.path, field.accepts, field.default, field.about))
            .collect();
        assert_eq!(
            lines,
            [
                "env / { car-racing: … } / required / The world.",
                "env.car-racing / map / required / ",
                "env.car-racing.time_limit / integer / 0 / Steps until it ends.",
                "layers / list of integer / required / ",
                "shape / gaussian | beta / required / The shape.",
                "limit / integer / optional / ",
                "rate / number / 0.0 / ",
            ]
        );
    }

    #[test]
    fn a_sample_is_accepted_by_the_type() {
        let params: Params = serde_json::from_value(sample(&root())).unwrap();
        assert!(matches!(params.shape, Shape::Gaussian));
    }
}
