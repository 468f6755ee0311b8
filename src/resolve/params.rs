//! Converts values with places to the parameters of a kind, and the problems that the kind finds back to places.

use dril_stage_api::ParamProblem;
use serde_json::Value as Json;

use crate::spec::node::{Key, Node, Value};
use crate::spec::problem::Problem;
use crate::spec::source::Span;

/// The value without its places.
pub(super) fn to_json(node: &Node) -> Json {
    match &node.value {
        Value::Null | Value::Broken => Json::Null,
        Value::Bool(value) => Json::Bool(*value),
        Value::Number(number, _) => Json::Number(number.clone()),
        Value::Text(text) => Json::String(text.to_string()),
        Value::List(items) => Json::Array(items.iter().map(to_json).collect()),
        Value::Map(entries) => {
            Json::Object(entries.iter().map(|(key, node)| (key.text.to_string(), to_json(node))).collect())
        }
    }
}

/// As [`to_json`], for the parameters of a kind: numbers in the text parameters `texts` keep their spelling.
pub(super) fn to_params(with: &Node, texts: &[&str]) -> Json {
    let Value::Map(entries) = &with.value else { return to_json(with) };
    let param = |(key, node): &(Key, Node)| {
        let value = if texts.contains(&&*key.text) { to_texts(node) } else { to_json(node) };
        (key.text.to_string(), value)
    };
    Json::Object(entries.iter().map(param).collect())
}

fn to_texts(node: &Node) -> Json {
    match &node.value {
        Value::Number(..) => node.written().map_or(Json::Null, |text| Json::String(text.to_string())),
        Value::List(items) => Json::Array(items.iter().map(to_texts).collect()),
        Value::Map(entries) => {
            Json::Object(entries.iter().map(|(key, node)| (key.text.to_string(), to_texts(node))).collect())
        }
        _ => to_json(node),
    }
}

/// A problem that a kind found in `with`, the parameters of `stage`, at the place of the value. `whole` is the place of missing
/// values.
pub(super) fn explain(found: &ParamProblem, with: &Node, stage: &str, whole: Span) -> Problem {
    let reached = follow(with, &found.path);
    let words = found.message.trim_end_matches('.');
    let unknown = unknown_name(words).and_then(|seen| reached.key_called(seen));
    let (message, better) = match words.strip_prefix("found ") {
        Some(rest) if reached.whole => {
            let (plain, better) = plain_words(rest, reached.node);
            (format!("stage `{stage}`: `{}` is {plain}", found.path.join(".")), better)
        }
        _ => (format!("stage `{stage}`{}: {words}", inside(words, &found.path)), None),
    };
    if let Some(problem) = several(found, &reached, stage) {
        return problem;
    }
    let better = better.or_else(|| missing(words));
    let at = unknown.map_or_else(|| reached.place(whole), |key| key.span);
    let used = reached.node.via.filter(|_| at == reached.node.span);
    let doubled = (words.starts_with("unknown field `with`") && found.path.len() < 2)
        .then(|| "leave `with` out: a profile and `--set` name the fields of a stage without it".to_owned());
    Problem::new(at, message)
        .maybe_hint(doubled)
        .maybe_hint(found.hint.clone().or(better))
        .maybe_related(used, "used here")
}

/// ", in `env.car-racing`" for what is unknown or missing somewhere inside.
fn inside(words: &str, path: &[String]) -> String {
    let parent = match path.split_last() {
        Some((_, parent)) if words.starts_with("unknown field") => parent,
        _ if words.starts_with("missing") || words.starts_with("unknown value") => path,
        _ => &[],
    };
    if parent.is_empty() { String::new() } else { format!(", in `{}`", parent.join(".")) }
}

/// How far a path leads.
struct Reached<'n> {
    key: Option<&'n Key>,
    node: &'n Node,
    /// True where it leads to its end: the last node is the one that the path names.
    whole: bool,
}

impl<'n> Reached<'n> {
    fn place(&self, whole: Span) -> Span {
        match self.key {
            None => whole,
            Some(key) if self.node.span.is_empty() => key.span,
            Some(_) => self.node.span,
        }
    }

    /// The key of that name, here or just inside.
    fn key_called(&self, name: &str) -> Option<&'n Key> {
        let here = self.key.filter(|key| &*key.text == name);
        here.or_else(|| self.node.get(name).map(|(key, _)| key))
    }
}

fn follow<'n>(node: &'n Node, path: &[String]) -> Reached<'n> {
    let mut reached = Reached { key: None, node, whole: true };
    for name in path {
        let next = match &reached.node.value {
            Value::Map(_) => reached.node.get(name).map(|(key, node)| (Some(key), node)),
            Value::List(items) => {
                name.parse::<usize>().ok().and_then(|at| items.get(at)).map(|item| (reached.key, item))
            }
            _ => None,
        };
        match next {
            Some((key, node)) => reached = Reached { key, node, whole: true },
            None => return Reached { whole: false, ..reached },
        }
    }
    reached
}

/// The name in "unknown field `x`" and its like, and in what is said of a former name.
fn unknown_name(message: &str) -> Option<&str> {
    let former = message.contains("` is now `") || message.ends_with("` is no longer a parameter");
    if former || message.starts_with("unknown ") { message.split('`').nth(1) } else { None }
}

/// Translates serde's message about a type to the terms of pipeline files.
fn plain_words(text: &str, node: &Node) -> (String, Option<String>) {
    let Some((_, expected)) = text.split_once(", expected ") else { return (text.to_owned(), None) };
    let (expected, hint) = match expected {
        "u8" | "u16" | "u32" | "u64" | "usize" => ("a whole number of at least 0", whole_number(node)),
        "i8" | "i16" | "i32" | "i64" | "isize" => ("a whole number", whole_number(node)),
        "f32" | "f64" => ("a number", without_underscores(node)),
        "a boolean" => ("`true` or `false`", boolean(node)),
        "a string" => ("a text", scalar(node)),
        "a sequence" => ("a list", None),
        "string or map" => ("a name, or a map with one name in it", None),
        "map with a single key" => ("a map with one name in it", None),
        other if other.starts_with("struct ") || other == "a map" => ("a map of fields", None),
        other => (other, None),
    };
    (format!("{}, expected {expected}", node.describe()), hint)
}

fn whole_number(node: &Node) -> Option<String> {
    match &node.value {
        Value::Number(number, _) => {
            let value =
                number.as_f64().filter(|value| value.fract() == 0.0 && (0.0..9e15).contains(value))?;
            number
                .is_f64()
                .then(|| format!("write `{value:.0}`: a number with a point or an exponent is not whole"))
        }
        _ => without_underscores(node),
    }
}

fn without_underscores(node: &Node) -> Option<String> {
    let Value::Text(text) = &node.value else { return None };
    let digits = text.replace('_', "");
    let number =
        digits.trim_start_matches('0').parse::<f64>().is_ok() && digits != **text || text.starts_with('0');
    number.then(|| {
        format!("YAML numbers have no `_` and no leading zeros: write `{}`", digits.trim_start_matches('0'))
    })
}

fn boolean(node: &Node) -> Option<String> {
    let Value::Text(text) = &node.value else { return None };
    match text.to_lowercase().as_str() {
        "yes" | "on" | "y" => Some("in YAML 1.2 that is a text: write `true`".to_owned()),
        "no" | "off" | "n" => Some("in YAML 1.2 that is a text: write `false`".to_owned()),
        _ => None,
    }
}

fn scalar(node: &Node) -> Option<String> {
    node.scalar_text().map(|text| format!("write it in quotes: `\"{text}\"`"))
}

/// Two alternatives in one place: usually because of merging.
fn several(found: &ParamProblem, reached: &Reached<'_>, stage: &str) -> Option<Problem> {
    let Value::Map(entries) = &reached.node.value else { return None };
    let ([first, .., last], true) = (entries.as_slice(), found.message.contains("map with a single key"))
    else {
        return None;
    };
    let path = found.path.join(".");
    let message = format!(
        "stage `{stage}`: `{path}` is both `{}` and `{}`, expected one of them",
        first.0.text, last.0.text
    );
    let problem = Problem::new(last.0.span, message).maybe_related(Some(first.0.span), "the other");
    Some(
        problem.hint(
            "the maps of defaults, stage and profile are merged; one written as `!replace { ... }` is not",
        ),
    )
}

fn missing(words: &str) -> Option<String> {
    let name = words.strip_prefix("missing field `")?.strip_suffix('`')?;
    Some(format!("add `{name}: ...`; it has no default"))
}
