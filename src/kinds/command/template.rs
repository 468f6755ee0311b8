//! The placeholders of a command: `{inputs.name}` and so on.
//!
//! Only the forms below are placeholders; all other braces belong to the program (`awk '{print}'`, JSON, a shell's `${x}`) and need
//! no escape. What looks like a misspelt placeholder is an error.

use std::ops::Range;

/// A piece of a text.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(super) enum Piece<'t> {
    /// As it is.
    Text(&'t str),
    /// `{inputs.name}`
    Input(&'t str),
    /// `{outputs.name}`
    Output(&'t str),
    /// `{checkpoints}`
    Checkpoints,
    /// `{seed}`
    Seed,
}

/// The placeholders, for messages.
pub(super) const FORMS: &str = "`{inputs.name}`, `{outputs.name}`, `{checkpoints}` and `{seed}`";

const WORDS: [&str; 4] = ["inputs", "outputs", "checkpoints", "seed"];

/// Parses `text`; the error is a misspelt placeholder.
pub(super) fn pieces(text: &str) -> Result<Vec<Piece<'_>>, String> {
    let mut pieces = Vec::new();
    let mut begin = 0;
    let mut at = 0;
    while let Some(open) = text[at..].find('{').map(|found| at + found) {
        let Some(inside) = braced(text, open) else {
            at = open + 1;
            continue;
        };
        let name = &text[inside.clone()];
        let doubled = text[..open].ends_with('{') && open > begin && text[inside.end + 1..].starts_with('}');
        let piece = match form(name) {
            // `{{seed}}` is the text `{seed}`.
            Some(_) if doubled => {
                pieces.push(Piece::Text(&text[begin..open]));
                pieces.push(Piece::Text(&text[inside.start..=inside.end]));
                begin = inside.end + 2;
                at = begin;
                continue;
            }
            Some(piece) => piece,
            None if is_slip(name) => return Err(format!("`{{{name}}}` is not one of {FORMS}")),
            None => {
                at = open + 1;
                continue;
            }
        };
        pieces.push(Piece::Text(&text[begin..open]));
        pieces.push(piece);
        begin = inside.end + 1;
        at = begin;
    }
    pieces.push(Piece::Text(&text[begin..]));
    pieces.retain(|piece| *piece != Piece::Text(""));
    Ok(pieces)
}

/// The name in the braces that open at `open`; `None` where the braces contain something else.
fn braced(text: &str, open: usize) -> Option<Range<usize>> {
    let rest = &text[open + 1..];
    let end = rest.find(|c: char| !(c.is_ascii_alphanumeric() || "_-.".contains(c)))?;
    (end > 0 && rest[end..].starts_with('}')).then(|| open + 1..open + 1 + end)
}

fn form(name: &str) -> Option<Piece<'_>> {
    match name.split_once('.') {
        Some(("inputs", name)) if is_name(name) => Some(Piece::Input(name)),
        Some(("outputs", name)) if is_name(name) => Some(Piece::Output(name)),
        None if name == "checkpoints" => Some(Piece::Checkpoints),
        None if name == "seed" => Some(Piece::Seed),
        _ => None,
    }
}

fn is_slip(name: &str) -> bool {
    let first = name.split('.').next().unwrap_or_default();
    WORDS.iter().any(|word| strsim::damerau_levenshtein(first, word) <= 1)
}

/// A letter, then letters, digits, `-` and `_`: as everything in a pipeline file is named.
pub(super) fn is_name(text: &str) -> bool {
    text.starts_with(|c: char| c.is_ascii_alphabetic())
        && text.len() <= 100
        && text.chars().all(|c| c.is_ascii_alphanumeric() || "_-".contains(c))
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn shown(text: &str) -> String {
        match pieces(text) {
            Ok(pieces) => pieces
                .iter()
                .map(|piece| match piece {
                    Piece::Text(text) => (*text).to_owned(),
                    Piece::Input(name) => format!("<in {name}>"),
                    Piece::Output(name) => format!("<out {name}>"),
                    Piece::Checkpoints => "<checkpoints>".to_owned(),
                    Piece::Seed => "<seed>".to_owned(),
                })
                .collect(),
            Err(error) => format!("error: {error}"),
        }
    }

    #[test]
    fn a_command_is_split_at_its_placeholders() {
        for (text, expected) in [
            ("plain", "plain"),
            ("{inputs.raw}", "<in raw>"),
            ("cat {inputs.a} {inputs.b-2} > {outputs.all}", "cat <in a> <in b-2> > <out all>"),
            ("--seed={seed} {checkpoints}/last", "--seed=<seed> <checkpoints>/last"),
            ("awk '{print}' {inputs.a}", "awk '{print}' <in a>"),
            ("${HOME} {} {\"a\": 1} {x", "${HOME} {} {\"a\": 1} {x"),
            ("{{seed}} {{x}}", "{seed} {{x}}"),
            ("{{inputs.a}}", "{inputs.a}"),
            ("{", "{"),
            ("{inputs.ä}", "{inputs.ä}"),
        ] {
            assert_eq!(shown(text), expected, "{text}");
        }
    }

    #[test]
    fn a_misspelt_placeholder_is_refused() {
        for text in
            ["{input.raw}", "{inputs}", "{outputs.}", "{output.x}", "{sed}", "{checkpoint}", "{inputs.a.b}"]
        {
            assert!(shown(text).starts_with("error: `{"), "{text}: {}", shown(text));
        }
    }

    proptest! {
        #[test]
        fn no_text_is_lost_where_there_is_no_placeholder(text in "[a-z{} ü$.]{0,20}") {
            if let Ok(pieces) = pieces(&text) && pieces.iter().all(|piece| matches!(piece, Piece::Text(_))) {
                let joined: String =
                    pieces.iter().map(|piece| if let Piece::Text(text) = piece { *text } else { "" }).collect();
                prop_assert_eq!(joined.len() + 2 * text.matches("{{seed}}").count(), text.len());
            }
        }
    }
}
