//! Parses input references: `stage`, `stage.output`, `stage[axis=value, axis=*, axis=a|b, axis=$x].output`.

use std::ops::Range;

use super::template;

/// A part of the text.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(super) struct Word<'t> {
    pub text: &'t str,
    pub range: Range<usize>,
}

/// A parsed input reference.
#[derive(Debug, PartialEq, Eq)]
pub(super) struct Reference<'t> {
    pub stage: Word<'t>,
    pub selectors: Vec<Selector<'t>>,
    pub output: Option<Word<'t>>,
}

/// The selector of one axis.
#[derive(Debug, PartialEq, Eq)]
pub(super) struct Selector<'t> {
    pub axis: Word<'t>,
    /// Alternatives; `*` alone selects all values, `$path` the value of that name.
    pub values: Vec<Word<'t>>,
}

/// Why and where a text is not an input reference.
#[derive(Debug, PartialEq, Eq)]
pub(super) struct BadReference {
    pub range: Range<usize>,
    pub message: String,
}

/// The syntax, for hints.
pub(super) const FORM: &str =
    "write `stage`, `stage.output`, `stage[axis=value, axis=*].output` or `{ file: path }`";

/// Parses an input reference.
pub(super) fn parse(text: &str) -> Result<Reference<'_>, BadReference> {
    let whole = word(text, 0..text.len());
    let bad = |range: Range<usize>, message: &str| Err(BadReference { range, message: message.to_owned() });
    let end = whole.text.find(['[', '.']).unwrap_or(whole.text.len()) + whole.range.start;
    let stage = word(text, whole.range.start..end);
    if !is_name(stage.text) {
        return bad(stage.range, "expected the name of a stage");
    }
    let mut at = end;
    let mut selectors = Vec::new();
    if text[at..whole.range.end].starts_with('[') {
        let Some(close) = text[at..whole.range.end].find(']').map(|found| at + found) else {
            return bad(at..whole.range.end, "found `[` without a `]`");
        };
        selectors = parse_selectors(text, at + 1..close)?;
        at = close + 1;
    }
    let rest = &text[at..whole.range.end];
    let output = match rest.strip_prefix('.') {
        Some(name) if is_name(name) => Some(word(text, at + 1..whole.range.end)),
        Some(_) => return bad(at..whole.range.end, "expected the name of an output after the `.`"),
        None if rest.is_empty() => None,
        None => return bad(at..whole.range.end, "expected `.output` or the end here"),
    };
    Ok(Reference { stage, selectors, output })
}

fn parse_selectors(text: &str, range: Range<usize>) -> Result<Vec<Selector<'_>>, BadReference> {
    split(text, range, ',').into_iter().map(|part| selector(text, part)).collect()
}

fn selector<'t>(text: &'t str, part: Word<'t>) -> Result<Selector<'t>, BadReference> {
    let bad = |range: Range<usize>, message: &str| Err(BadReference { range, message: message.to_owned() });
    let Some(equals) = part.text.find('=').map(|found| part.range.start + found) else {
        let message = if part.text.is_empty() {
            "expected `axis=value` between the brackets"
        } else {
            "expected `axis=value`"
        };
        return bad(part.range, message);
    };
    let axis = word(text, part.range.start..equals);
    if !is_name(axis.text) {
        return bad(axis.range.start..equals + 1, "expected the name of an axis before the `=`");
    }
    let values = split(text, equals + 1..part.range.end, '|');
    for value in &values {
        if value.text.is_empty() {
            return bad(value.range.clone(), "expected a value of the axis, or `*` for all");
        }
        if value.text.contains(['=', '['])
            || value.text.starts_with('$') && !template::is_path(&value.text[1..])
        {
            return bad(value.range.clone(), "expected a value of the axis, `*`, or `$name`");
        }
        if value.text == "*" && values.len() > 1 {
            return bad(value.range.clone(), "`*` selects all values, expected it alone");
        }
    }
    Ok(Selector { axis, values })
}

/// The trimmed parts of a range.
fn split(text: &str, range: Range<usize>, by: char) -> Vec<Word<'_>> {
    let mut begin = range.start;
    let parts = text[range].split(by).map(|part| {
        let found = word(text, begin..begin + part.len());
        begin += part.len() + 1;
        found
    });
    parts.collect()
}

fn word(text: &str, range: Range<usize>) -> Word<'_> {
    let part = &text[range.clone()];
    let start = range.start + (part.len() - part.trim_start().len());
    let trimmed = part.trim();
    Word { text: trimmed, range: start..start + trimmed.len() }
}

fn is_name(text: &str) -> bool {
    !text.is_empty() && text.chars().all(|c| c.is_alphanumeric() || c == '-' || c == '_')
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn shown(text: &str) -> String {
        match parse(text) {
            Ok(found) => {
                let selectors = found.selectors.iter().map(|selector| {
                    let values: Vec<&str> = selector.values.iter().map(|value| value.text).collect();
                    format!("[{}={}]", selector.axis.text, values.join("|"))
                });
                let output = found.output.map(|output| format!(".{}", output.text)).unwrap_or_default();
                format!("{}{}{output}", found.stage.text, selectors.collect::<String>())
            }
            Err(bad) => format!("{} at {:?}", bad.message, &text[bad.range]),
        }
    }

    #[test]
    fn wirings_are_taken_apart() {
        for (text, expected) in [
            ("clone", "clone"),
            (" clone.policy ", "clone.policy"),
            ("a[x=1]", "a[x=1]"),
            ("a[ x = two words , y=*, z=a | b ].out", "a[x=two words][y=*][z=a|b].out"),
            ("a[x=$seed]", "a[x=$seed]"),
            ("a[x=0.5].b", "a[x=0.5].b"),
        ] {
            assert_eq!(shown(text), expected);
        }
    }

    #[test]
    fn an_invalid_reference_is_refused_with_its_place() {
        for (text, expected) in [
            ("", "expected the name of a stage at \"\""),
            ("a b", "expected the name of a stage at \"a b\""),
            ("a[x=1", "found `[` without a `]` at \"[x=1\""),
            ("a[]", "expected `axis=value` between the brackets at \"\""),
            ("a[clipped]", "expected `axis=value` at \"clipped\""),
            ("a[x=]", "expected a value of the axis, or `*` for all at \"\""),
            ("a[x=*|b]", "`*` selects all values, expected it alone at \"*\""),
            ("a[x=1]out", "expected `.output` or the end here at \"out\""),
            ("a.", "expected the name of an output after the `.` at \".\""),
            ("a.b.c", "expected the name of an output after the `.` at \".b.c\""),
            ("a[=1]", "expected the name of an axis before the `=` at \"=\""),
        ] {
            assert_eq!(shown(text), expected, "{text}");
        }
    }

    proptest! {
        #[test]
        fn any_text_is_taken_apart_or_refused_with_a_place_inside_it(text in "[a-c.=\\[\\]|*,$ ü]{0,12}") {
            if let Err(bad) = parse(&text) {
                prop_assert!(text.get(bad.range).is_some());
            }
        }
    }
}
