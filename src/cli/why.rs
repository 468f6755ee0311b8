//! Why a stage is stale, as text and as JSON.

use serde_json::{Value, json};

use super::terminal::{cut, printable};
use crate::plan::Reason;

/// Longer values are cut in text; `--json` has them in full.
const LONGEST_VALUE: usize = 48;

/// The reasons on one line.
pub(super) fn text(reasons: &[Reason]) -> String {
    joined(reasons, &one, &input)
}

/// As [`text`], with stages instead of their instances where inputs come from.
pub(super) fn of_any_instance(reasons: &[Reason]) -> String {
    joined(reasons, &one, &|port, from, _| format!("input `{port}` differs ({})", stage_of(&printable(from))))
}

/// What sort of change this is, without its values: equal for instances of a stage to which the same has happened.
pub(super) fn shape(reasons: &[Reason]) -> String {
    let one = |reason: &Reason| match reason {
        Reason::Param { path, .. } => path.clone(),
        Reason::Seed { .. } => "seed".to_owned(),
        Reason::Rights { port, executable, .. } => format!("{port} {executable}"),
        Reason::Damaged { .. } => "damaged".to_owned(),
        other => one(other),
    };
    joined(reasons, &one, &|port, from, _| format!("{port} {}", stage_of(from)))
}

/// A source of an input without the coordinates of its instance.
fn stage_of(from: &str) -> String {
    // What follows the first dot is an output, or the path of a file.
    match from.find(['[', '.', ' ']).filter(|at| from[*at..].starts_with('[')) {
        Some(open) => match from[open..].find(']') {
            Some(close) => format!("{}{}", &from[..open], &from[open + close + 1..]),
            None => from.to_owned(),
        },
        None => from.to_owned(),
    }
}

/// Each reason by `one`, and an input by `input`: its name, its first new part, and the number of its new parts.
fn joined(
    reasons: &[Reason],
    one: &dyn Fn(&Reason) -> String,
    input: &dyn Fn(&str, &str, usize) -> String,
) -> String {
    let mut words: Vec<String> = Vec::new();
    let mut rest = reasons;
    while let Some((reason, behind)) = rest.split_first() {
        rest = behind;
        if let Reason::Input { port, from, .. } = reason {
            // A fan-in with many new parts is one reason.
            let same = |other: &&Reason| matches!(other, Reason::Input { port: other, .. } if other == port);
            let parts = 1 + behind.iter().take_while(same).count();
            rest = &behind[parts - 1..];
            words.push(input(port, from, parts));
        } else {
            words.push(one(reason));
        }
    }
    words.join(", ")
}

fn input(port: &str, from: &str, parts: usize) -> String {
    let from = printable(from);
    match parts {
        1 => format!("input `{port}` differs ({from})"),
        _ => format!("input `{port}` differs ({from} and {} more)", parts - 1),
    }
}

fn one(reason: &Reason) -> String {
    match reason {
        Reason::New => "new".to_owned(),
        Reason::Forced => "forced by `--force`".to_owned(),
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
        Reason::Input { port, from, .. } => input(port, from, 1),
        Reason::Rights { port, from, executable } => {
            let now = if *executable { "may be executed now" } else { "may not be executed any more" };
            format!("input {port} ({}) {now}", printable(from))
        }
        Reason::Lost { output } => format!("output `{output}` is missing in the store"),
        Reason::Damaged { error } => format!("its record cannot be read ({})", printable(error)),
    }
}

/// A reason as JSON: `because` names the sort, the other fields are its own, parameters with their values as JSON.
pub(super) fn json(reason: &Reason) -> Value {
    let mut json = json!(reason);
    if let Reason::Param { old, new, .. } = reason {
        json["old"] = value(old);
        json["new"] = value(new);
    }
    json
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
        let expected = json!({ "because": "param", "path": "total_steps", "old": 2_998_272, "new": 100_000 });
        assert_eq!(json(&reason), expected);
    }

    #[test]
    fn many_parts_of_a_fan_in_are_one_reason() {
        let part = |port: &str, from: &str| Reason::Input {
            port: port.into(),
            from: from.into(),
            old: None,
            new: None,
        };
        let reasons = [part("scores", "a"), part("scores", "b"), part("scores", "c"), part("policy", "d")];
        assert_eq!(text(&reasons), "input `scores` differs (a and 2 more), input `policy` differs (d)");
    }

    #[test]
    fn instances_of_a_stage_have_the_same_change_whatever_its_values() {
        let changed = |value: &str, from: &str| {
            [
                Reason::Param { path: "n".into(), old: Some(value.into()), new: None },
                Reason::Input { port: "parts".into(), from: from.into(), old: None, new: None },
            ]
        };
        let (one, other) = (changed("1", "say[x=1.5, y=a].text"), changed("2", "say[x=2, y=b].text"));
        assert_eq!(shape(&one), shape(&other));
        assert_eq!(of_any_instance(&one), "n: 1 -> (not set), input `parts` differs (say.text)");
        assert_ne!(shape(&one), shape(&changed("1", "count[x=1.5, y=a].text")));
        assert_ne!(shape(&one), shape(&one[..1]));
        for (from, stage) in [
            ("say[x=1.5].text, file a[1].txt", "say.text, file a[1].txt"),
            ("say.text, file a[1].txt", "say.text, file a[1].txt"),
            ("file a[1].txt", "file a[1].txt"),
        ] {
            assert_eq!(stage_of(from), stage);
        }
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
