//! Parameters of a stage: from the pipeline file's values to the kind's own type and back, reporting all problems at once.

use std::ops::RangeBounds;

use schemars::JsonSchema;
use serde::de::DeserializeOwned;
use serde_json::Value;

use crate::suggest;

/// Something wrong with one parameter.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct ParamProblem {
    /// Path from the root of `with:`, as field names and list indices; empty for the whole value.
    pub path: Vec<String>,
    /// What was seen and what was expected; lower case, names in backticks.
    pub message: String,
    /// How to fix it, if known.
    pub hint: Option<String>,
}

impl ParamProblem {
    /// A problem with the value at `path` (dotted, as `env.time_limit`).
    pub(crate) fn new(path: &str, message: impl Into<String>) -> Self {
        let path = path.split('.').filter(|part| !part.is_empty()).map(str::to_owned).collect();
        Self { path, message: message.into(), hint: None }
    }
}

/// Collects the problems of one stage's parameters.
#[derive(Debug, Default)]
pub struct Problems {
    found: Vec<ParamProblem>,
}

impl Problems {
    /// Reports a problem with the value at `path` (dotted, as `env.time_limit`).
    pub fn add(&mut self, path: &str, message: impl Into<String>) {
        self.push(ParamProblem::new(path, message));
    }

    /// Reports a name at `path` that is none of `known`, with the nearest of them. `what` it should be, and `whose` the known ones
    /// are: "column", "its columns".
    pub fn unknown(&mut self, path: &str, what: &str, seen: &str, whose: &str, known: &[&str]) {
        let hint = Some(nearest_and_known(seen, whose, known));
        self.push(ParamProblem { hint, ..ParamProblem::new(path, format!("unknown {what} `{seen}`")) });
    }

    pub(crate) fn push(&mut self, problem: ParamProblem) {
        self.found.push(problem);
    }

    /// Reports `value` if it is outside `range`; `expected` describes the range, as in "more than 0".
    pub fn range<T: PartialOrd + std::fmt::Display>(
        &mut self,
        path: &str,
        value: T,
        range: impl RangeBounds<T>,
        expected: &str,
    ) {
        if !range.contains(&value) {
            self.add(path, format!("`{path}` is {value}, expected {expected}"));
        }
    }

    /// Reports a count of 0.
    pub fn positive(&mut self, path: &str, value: u64) {
        self.range(path, value, 1.., "at least 1");
    }

    /// Reports a number that is not finite and more than 0.
    pub fn positive_number(&mut self, path: &str, value: f64) {
        if !(value.is_finite() && value > 0.0) {
            self.add(path, format!("`{path}` is {value}, expected a number more than 0"));
        }
    }

    /// Reports a number outside 0..=1.
    pub fn fraction(&mut self, path: &str, value: f64) {
        self.range(path, value, 0.0..=1.0, "a number from 0 to 1");
    }

    /// The problems, in the order they were reported.
    pub fn into_vec(self) -> Vec<ParamProblem> {
        self.found
    }
}

/// A struct that is flattened into a kind's parameters (`#[serde(flatten)]`).
///
/// serde reads such a struct from a buffer, which loses the path of each value; to report problems with their paths, each
/// part is read separately. The struct must not deny unknown fields; the struct that it is flattened into must.
#[derive(Clone, Copy, Debug)]
pub struct Part {
    schema: fn() -> schemars::Schema,
    read: fn(Value, &mut Vec<ParamProblem>),
}

impl Part {
    /// The part of type `P`.
    pub const fn of<P: DeserializeOwned + JsonSchema>() -> Self {
        Self { schema: || schemars::schema_for!(P), read: read_all::<P> }
    }
}

/// Names of parameters that a kind declares beside their type; see [`crate::Describe`].
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct Names {
    pub(crate) parts: &'static [Part],
    pub(crate) renamed: &'static [(&'static str, &'static str)],
    pub(crate) removed: &'static [(&'static str, &'static str)],
}

impl Names {
    /// The problem to report for a former name.
    fn former(&self, seen: &str) -> Option<ParamProblem> {
        let find = |list: &[(&'static str, &'static str)]| list.iter().find(|(old, _)| *old == seen).copied();
        let path = vec![seen.to_owned()];
        if let Some((_, new)) = find(self.renamed) {
            return Some(ParamProblem { path, message: format!("`{seen}` is now `{new}`"), hint: None });
        }
        let (_, instead) = find(self.removed)?;
        let hint = Some(instead.to_owned());
        Some(ParamProblem { path, message: format!("`{seen}` is no longer a parameter"), hint })
    }
}

/// Reads `value` as `P` and reports all invalid fields, not only the first: a field that cannot be read is reported and
/// removed, and the rest is read again.
pub(crate) fn read<P>(value: &Value, names: &Names) -> Result<P, Vec<ParamProblem>>
where
    P: DeserializeOwned + JsonSchema,
{
    // Tracking paths costs several times as much as reading, and few values are wrong.
    if let Ok(params) = P::deserialize(value) {
        return Ok(params);
    }
    let mut rest = value.clone();
    let mut found = Vec::new();
    set_former_names_aside(&mut rest, names, &mut found);
    if !names.parts.is_empty() {
        set_unknown_names_aside(&mut rest, &properties(&schemars::schema_for!(P)), &mut found);
    }
    for part in names.parts {
        read_part(part, &mut rest, &mut found);
    }
    read_all::<P>(rest, &mut found);
    if found.is_empty() {
        // Should not happen: reading with and without paths agrees.
        return P::deserialize(value).map_err(|error| vec![describe(&[], &error.to_string())]);
    }
    Err(found)
}

/// Reads `rest` as `P` until it succeeds, and adds the problems to `found`.
fn read_all<P: DeserializeOwned>(mut rest: Value, found: &mut Vec<ParamProblem>) {
    while let Err(error) = serde_path_to_error::deserialize::<_, P>(&rest) {
        let path = segments(error.path());
        let message = error.inner().to_string();
        // A removed field is then reported as missing; only the first report counts.
        let echo = is_echo(&path, &message, found);
        if !echo {
            found.push(describe(&path, &message));
        }
        if echo || !remove(&mut rest, &path) {
            return;
        }
    }
}

/// True if a field is missing because it, or a part of it, was reported before.
fn is_echo(path: &[String], message: &str, found: &[ParamProblem]) -> bool {
    let name = message.strip_prefix("missing field `").and_then(|rest| rest.split('`').next());
    name.is_some_and(|name| {
        let inside = |problem: &ParamProblem| {
            problem.path.starts_with(path) && problem.path.get(path.len()).is_some_and(|part| part == name)
        };
        found.iter().any(inside)
    })
}

/// Reports former names and removes the fields.
fn set_former_names_aside(rest: &mut Value, names: &Names, found: &mut Vec<ParamProblem>) {
    let Value::Object(fields) = rest else { return };
    fields.retain(|name, _| match names.former(name) {
        Some(problem) => {
            found.push(problem);
            false
        }
        None => true,
    });
}

/// Reports fields that are not in the schema, and removes them: with a flattened struct, serde does not list known fields.
fn set_unknown_names_aside(rest: &mut Value, known: &[String], found: &mut Vec<ParamProblem>) {
    let Value::Object(fields) = rest else { return };
    let known: Vec<&str> = known.iter().map(String::as_str).collect();
    fields.retain(|name, _| {
        let is_known = known.contains(&name.as_str());
        if !is_known {
            let hint = Some(known_names(name, &known));
            found.push(ParamProblem {
                path: vec![name.clone()],
                message: format!("unknown field `{name}`"),
                hint,
            });
        }
        is_known
    });
}

/// Reports invalid fields of a flattened struct, and removes them.
fn read_part(part: &Part, rest: &mut Value, found: &mut Vec<ParamProblem>) {
    let Value::Object(fields) = rest else { return };
    let names = properties(&(part.schema)());
    let own = names.iter().filter_map(|name| Some((name.clone(), fields.get(name)?.clone())));
    let before = found.len();
    (part.read)(Value::Object(own.collect()), found);
    for problem in found.iter().skip(before) {
        if let Some(field) = problem.path.first() {
            fields.remove(field);
        }
    }
}

/// The names of the fields of a struct.
fn properties(schema: &schemars::Schema) -> Vec<String> {
    let fields = schema.get("properties").and_then(Value::as_object);
    fields.into_iter().flat_map(|fields| fields.keys().cloned()).collect()
}

fn segments(path: &serde_path_to_error::Path) -> Vec<String> {
    use serde_path_to_error::Segment;
    path.iter()
        .filter_map(|segment| match segment {
            Segment::Seq { index } => Some(index.to_string()),
            Segment::Map { key } => Some(key.clone()),
            Segment::Enum { variant } => Some(variant.clone()),
            Segment::Unknown => None,
        })
        .collect()
}

/// Removes the value at `path`; false if there is none (the whole value is invalid, or a field is missing).
fn remove(value: &mut Value, path: &[String]) -> bool {
    let Some((last, parents)) = path.split_last() else { return false };
    let mut at = value;
    for part in parents {
        let next = match at {
            Value::Object(map) => map.get_mut(part),
            Value::Array(list) => part.parse::<usize>().ok().and_then(|i| list.get_mut(i)),
            _ => None,
        };
        let Some(next) = next else { return false };
        at = next;
    }
    match at {
        Value::Object(map) => map.remove(last).is_some(),
        // Lists are left as they are: removing an item would shift the indices of later errors.
        _ => false,
    }
}

/// Rephrases serde's message, with the nearest known name for a misspelt one.
fn describe(path: &[String], message: &str) -> ParamProblem {
    let mut hint = None;
    let mut text = message.to_owned();
    if let Some(rest) = message.strip_prefix("unknown field `")
        && let Some((seen, rest)) = rest.split_once('`')
    {
        let known: Vec<&str> = rest.split('`').skip(1).step_by(2).collect();
        text = format!("unknown field `{seen}`");
        hint = Some(known_names(seen, &known));
    } else if let Some(rest) = message.strip_prefix("unknown variant `")
        && let Some((seen, rest)) = rest.split_once('`')
    {
        let known: Vec<&str> = rest.split('`').skip(1).step_by(2).collect();
        text = format!("unknown value `{seen}`");
        hint = Some(known_names(seen, &known));
    } else if let Some(rest) = message.strip_prefix("invalid type: ") {
        text = format!("found {rest}");
    } else if let Some(rest) = message.strip_prefix("invalid value: ") {
        text = format!("found {rest}");
    }
    ParamProblem { path: path.to_vec(), message: text, hint }
}

fn known_names(seen: &str, known: &[&str]) -> String {
    if known.is_empty() {
        "there are none to set here".to_owned()
    } else {
        nearest_and_known(seen, "known", known)
    }
}

/// "did you mean `policy`? its labels are `policy`, `seed`"; `what` names the known ones: "its labels".
fn nearest_and_known(seen: &str, what: &str, known: &[&str]) -> String {
    let list = known.iter().map(|name| format!("`{name}`")).collect::<Vec<_>>().join(", ");
    match suggest::nearest(seen, known.iter().copied()) {
        Some(name) => format!("did you mean `{name}`? {what} are {list}"),
        None => format!("{what} are {list}"),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use serde::{Deserialize, Serialize};
    use serde_json::json;

    #[derive(Debug, Deserialize, Serialize, PartialEq, JsonSchema)]
    #[serde(deny_unknown_fields, default)]
    struct Inner {
        depth: u32,
    }
    impl Default for Inner {
        fn default() -> Self {
            Self { depth: 3 }
        }
    }
    #[derive(Debug, Deserialize, Serialize, PartialEq, JsonSchema)]
    #[serde(deny_unknown_fields)]
    struct Sample {
        steps: u64,
        #[serde(default)]
        inner: Inner,
    }

    /// What two kinds share.
    #[derive(Debug, Deserialize, Serialize, PartialEq, JsonSchema)]
    #[serde(default)]
    struct Shared {
        gamma: f64,
        n_envs: u64,
        to_step: Option<u64>,
    }
    impl Default for Shared {
        fn default() -> Self {
            Self { gamma: 0.99, n_envs: 4, to_step: None }
        }
    }
    #[derive(Debug, Deserialize, Serialize, PartialEq, JsonSchema)]
    #[serde(deny_unknown_fields)]
    struct Flat {
        steps: u64,
        #[serde(flatten)]
        shared: Shared,
    }
    const FLAT: Names = Names {
        parts: &[Part::of::<Shared>()],
        renamed: &[("envs", "n_envs")],
        removed: &[("precision", "all is computed with 32 bits")],
    };

    fn read<P: DeserializeOwned + JsonSchema>(value: &Value) -> Result<P, Vec<ParamProblem>> {
        super::read(value, &Names::default())
    }

    fn read_flat(value: &Value) -> Result<Flat, Vec<ParamProblem>> {
        super::read(value, &FLAT)
    }

    #[test]
    fn all_wrong_fields_are_reported_at_once() {
        let value = json!({"steps": 5, "inner": {"depth": "deep", "dept": 4}, "stepz": 1});
        let problems = read::<Sample>(&value).unwrap_err();
        let paths: Vec<_> = problems.iter().map(|p| p.path.join(".")).collect();
        assert_eq!(paths.len(), 3, "{problems:?}");
        for path in ["inner.depth", "inner.dept", "stepz"] {
            assert!(paths.iter().any(|p| p == path), "{path} not in {paths:?}");
        }
    }

    #[test]
    fn a_misspelt_field_names_the_one_that_was_meant() {
        let problems = read::<Sample>(&json!({"step": 5, "steps": 1})).unwrap_err();
        assert_eq!(problems[0].message, "unknown field `step`");
        assert!(problems[0].hint.as_deref().unwrap().starts_with("did you mean `steps`?"));
    }

    #[test]
    fn a_missing_field_is_an_error_and_a_defaulted_one_is_not() {
        let problems = read::<Sample>(&json!({})).unwrap_err();
        assert_eq!(problems[0].message, "missing field `steps`");
        assert_eq!(read::<Sample>(&json!({"steps": 1})).unwrap().inner.depth, 3);
    }

    #[test]
    fn fields_of_a_flattened_struct_are_read_beside_the_others() {
        let params = read_flat(&json!({"steps": 1, "n_envs": 8, "gamma": 1})).unwrap();
        assert_eq!(params.shared, Shared { gamma: 1.0, n_envs: 8, to_step: None });
        let back = serde_json::to_value(&params).unwrap();
        assert_eq!(back, json!({"steps": 1, "gamma": 1.0, "n_envs": 8, "to_step": null}));
        assert_eq!(read_flat(&back), Ok(params));
    }

    #[test]
    fn wrong_fields_of_a_flattened_struct_and_of_its_owner_are_reported_at_once() {
        let value = json!({"steps": "x", "gamma": "y", "n_envs": "z", "to_step": 1.5, "gama": 1});
        let problems = read_flat(&value).unwrap_err();
        let mut paths: Vec<_> = problems.iter().map(|p| p.path.join(".")).collect();
        paths.sort();
        assert_eq!(paths, ["gama", "gamma", "n_envs", "steps", "to_step"], "{problems:?}");
        let unknown = problems.iter().find(|p| p.path == ["gama"]).unwrap();
        assert_eq!(unknown.message, "unknown field `gama`");
        assert!(
            unknown.hint.as_deref().unwrap().starts_with("did you mean `gamma`? known are "),
            "{unknown:?}"
        );
        assert!(unknown.hint.as_deref().unwrap().contains("`steps`"), "{unknown:?}");
    }

    #[test]
    fn a_field_that_is_missing_is_reported_beside_wrong_ones() {
        let problems = read_flat(&json!({"gamma": "y"})).unwrap_err();
        let messages: Vec<&str> = problems.iter().map(|p| p.message.as_str()).collect();
        assert_eq!(messages.len(), 2, "{messages:?}");
        assert_eq!(messages[1], "missing field `steps`");
    }

    #[test]
    fn a_former_name_gives_an_error_that_names_the_new_one() {
        let problems = read_flat(&json!({"steps": 1, "envs": 8, "precision": "bf16"})).unwrap_err();
        assert_eq!(problems.len(), 2, "{problems:?}");
        assert_eq!(
            (problems[0].path.as_slice(), problems[0].message.as_str()),
            (&["envs".to_owned()][..], "`envs` is now `n_envs`")
        );
        assert_eq!(problems[1].message, "`precision` is no longer a parameter");
        assert_eq!(problems[1].hint.as_deref(), Some("all is computed with 32 bits"));
    }

    #[test]
    fn numbers_outside_their_range_are_reported_with_what_was_expected() {
        let mut problems = Problems::default();
        problems.fraction("gamma", 1.5);
        problems.positive("envs", 0);
        problems.positive_number("learning_rate", f64::NAN);
        problems.fraction("fine", 0.5);
        let found = problems.into_vec();
        assert_eq!(found.len(), 3);
        assert_eq!(found[0].message, "`gamma` is 1.5, expected a number from 0 to 1");
    }
}
