//! Parameters of a stage: from the pipeline file's values to the kind's own type and back, with every problem at once.

use std::ops::RangeBounds;

use serde::de::DeserializeOwned;
use serde_json::Value;

/// Something wrong with one parameter.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct ParamProblem {
    /// Where: field names and list positions from the root of `with:`; empty for the whole.
    pub path: Vec<String>,
    /// What was seen and what was expected; lower case, names in backticks.
    pub message: String,
    /// How to mend it, where that is known.
    pub hint: Option<String>,
}

/// Collects what is wrong with the values of one stage.
#[derive(Debug, Default)]
pub struct Problems {
    found: Vec<ParamProblem>,
}

impl Problems {
    /// Reports that the value at `path` (dotted, as `env.time_limit`) is wrong.
    pub fn add(&mut self, path: &str, message: impl Into<String>) {
        let path = path.split('.').filter(|part| !part.is_empty()).map(str::to_owned).collect();
        self.found.push(ParamProblem { path, message: message.into(), hint: None });
    }

    /// Reports `value` unless it is in `range`; `expected` says the range in words, as in "more than 0".
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

    /// What was found, in the order it was reported.
    pub fn into_vec(self) -> Vec<ParamProblem> {
        self.found
    }
}

/// Reads `value` as `P` and reports every wrong field, not only the first: a field that cannot be read is reported and
/// set aside, and the rest is read again.
pub(crate) fn read<P>(value: &Value) -> Result<P, Vec<ParamProblem>>
where
    P: DeserializeOwned,
{
    // Following where in the value it is costs several times as much as reading it, and few values are wrong.
    if let Ok(params) = P::deserialize(value) {
        return Ok(params);
    }
    let mut rest = value.clone();
    let mut found: Vec<ParamProblem> = Vec::new();
    loop {
        match serde_path_to_error::deserialize::<_, P>(&rest) {
            Ok(params) if found.is_empty() => return Ok(params),
            Ok(_) => return Err(found),
            Err(error) => {
                let path = segments(error.path());
                let message = error.inner().to_string();
                // A field that was set aside is then missing; only the first word about it is news.
                let echo = !found.is_empty() && message.starts_with("missing field");
                if !echo {
                    found.push(describe(&path, &message));
                }
                if echo || !remove(&mut rest, &path) {
                    return Err(found);
                }
            }
        }
    }
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

/// Removes the value at `path`; false where there is none (the whole value is wrong, or a field is missing).
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
        // A list keeps its positions: without them the next error would point at a neighbour.
        _ => false,
    }
}

/// serde's words, put into the project's form, with the nearest known name for a misspelt one.
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
    let nearest = known
        .iter()
        .map(|name| (strsim::damerau_levenshtein(seen, name), *name))
        .filter(|(distance, name)| *distance <= 1 + name.len() / 4)
        .min();
    let list = known.iter().map(|name| format!("`{name}`")).collect::<Vec<_>>().join(", ");
    match nearest {
        Some((_, name)) => format!("did you mean `{name}`? known are {list}"),
        None if known.is_empty() => "there are none to set here".to_owned(),
        None => format!("known are {list}"),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use serde::{Deserialize, Serialize};
    use serde_json::json;

    #[derive(Debug, Deserialize, Serialize, PartialEq)]
    #[serde(deny_unknown_fields, default)]
    struct Inner {
        depth: u32,
    }
    impl Default for Inner {
        fn default() -> Self {
            Self { depth: 3 }
        }
    }
    #[derive(Debug, Deserialize, Serialize, PartialEq)]
    #[serde(deny_unknown_fields)]
    struct Sample {
        steps: u64,
        #[serde(default)]
        inner: Inner,
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
