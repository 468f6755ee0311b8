//! Why a stage is stale, in words and as JSON.

use serde_json::{Value, json};

use super::terminal::{cut, printable};
use crate::plan::Reason;

/// Longer values are cut in the human output; `--json` has them in full.
const LONGEST_VALUE: usize = 48;

/// The reasons in one line.
pub(super) fn text(reasons: &[Reason]) -> String {
    reasons.iter().map(one).collect::<Vec<_>>().join(", ")
}

fn one(reason: &Reason) -> String {
    match reason {
        Reason::New => "new".to_owned(),
        Reason::Param { path, old, new } => {
            let value = |value: &Option<String>| match value {
                Some(value) => cut(&printable(value), LONGEST_VALUE),
                None => "(not set)".to_owned(),
            };
            format!("{path}: {} -> {}", value(old), value(new))
        }
        Reason::Seed { old, new } => {
            let seed = |seed: &Option<u64>| seed.map_or("(none)".to_owned(), |seed| seed.to_string());
            format!("seed: {} -> {}", seed(old), seed(new))
        }
        Reason::Revision { old, new } => format!("its kind was revised: {old} -> {new}"),
        Reason::Kind { old, new } => format!("kind: {old} -> {new}"),
        Reason::Input { port, from } => format!("input `{port}` differs ({from})"),
        Reason::Lost { output } => format!("output `{output}` is missing in the store"),
        Reason::Damaged { error } => format!("its record cannot be read ({})", printable(error)),
    }
}

/// A reason as JSON: `reason` names the sort, the other fields are its own.
pub(super) fn json(reason: &Reason) -> Value {
    match reason {
        Reason::New => json!({ "reason": "new" }),
        Reason::Param { path, old, new } => {
            json!({ "reason": "param", "path": path, "old": value(old), "new": value(new) })
        }
        Reason::Seed { old, new } => json!({ "reason": "seed", "old": old, "new": new }),
        Reason::Revision { old, new } => json!({ "reason": "revision", "old": old, "new": new }),
        Reason::Kind { old, new } => json!({ "reason": "kind", "old": old, "new": new }),
        Reason::Input { port, from } => json!({ "reason": "input", "port": port, "from": from }),
        Reason::Lost { output } => json!({ "reason": "lost", "output": output }),
        Reason::Damaged { error } => json!({ "reason": "damaged", "error": error }),
    }
}

/// The value that a reason holds as JSON text; `null` where the parameter was absent.
fn value(text: &Option<String>) -> Value {
    let Some(text) = text else { return Value::Null };
    serde_json::from_str(text).unwrap_or_else(|_| Value::String(text.clone()))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_changed_parameter_is_named_with_both_values() {
        let reason = Reason::Param {
            path: "total_steps".into(),
            old: Some("2998272".into()),
            new: Some("100000".into()),
        };
        assert_eq!(text(std::slice::from_ref(&reason)), "total_steps: 2998272 -> 100000");
        let expected = json!({ "reason": "param", "path": "total_steps", "old": 2_998_272, "new": 100_000 });
        assert_eq!(json(&reason), expected);
    }

    #[test]
    fn a_long_value_is_cut_for_people_and_whole_for_programs() {
        let long = format!("\"{}\"", "x".repeat(500));
        let reason = Reason::Param { path: "note".into(), old: None, new: Some(long) };
        assert!(text(std::slice::from_ref(&reason)).chars().count() < 90);
        assert_eq!(json(&reason)["new"], "x".repeat(500));
        assert_eq!(json(&reason)["old"], Value::Null);
    }
}
