//! The placeholders of a command: `{inputs.name}` and so on.
//!
//! Only the forms below are placeholders; all other braces belong to the program (`awk '{print}'`, JSON) and need no escape, and
//! braces right after a `$` belong to the shell (`${seed}` is a variable). What looks like a misspelt placeholder is an error.
//! Doubled braces are the text itself: `{{seed}}` is `{seed}`.

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

/// A placeholder, or what looks like a misspelt one.
struct Mark<'t> {
    /// Where its `{` is.
    open: usize,
    /// Where its `}` is.
    close: usize,
    name: &'t str,
    /// `None` for a misspelt one.
    piece: Option<Piece<'t>>,
}

/// The first one from `at` on.
fn mark(text: &str, mut at: usize) -> Option<Mark<'_>> {
    while let Some(open) = text[at..].find('{').map(|found| at + found) {
        at = open + 1;
        let Some(inside) = braced(text, open).filter(|_| !text[..open].ends_with('$')) else { continue };
        let name = &text[inside.clone()];
        let piece = form(name);
        if piece.is_some() || is_slip(name) {
            return Some(Mark { open, close: inside.end, name, piece });
        }
    }
    None
}

/// Parses `text`; the error is a misspelt placeholder.
pub(super) fn pieces(text: &str) -> Result<Vec<Piece<'_>>, String> {
    let mut pieces = Vec::new();
    let mut begin = 0;
    while let Some(Mark { open, close, name, piece }) = mark(text, begin) {
        pieces.push(Piece::Text(&text[begin..open]));
        let doubled = text[begin..open].ends_with('{') && text[close + 1..].starts_with('}');
        begin = close + 1;
        if doubled {
            pieces.push(Piece::Text(&text[open + 1..=close]));
            begin += 1;
        } else if let Some(piece) = piece {
            pieces.push(piece);
        } else {
            return Err(match name.split_once('/') {
                Some((first, rest)) => format!(
                    "`{{{name}}}` has a path in its braces, expected a name: a file in a folder is `{{{first}}}/{rest}`, and the \
                     path of an input or output is declared under `inputs` or `outputs`; write `{{{{{name}}}}}` if it is \
                     meant as text"
                ),
                None => format!(
                    "`{{{name}}}` is not one of {FORMS}; write `{{{{{name}}}}}` if it is meant as text"
                ),
            });
        }
    }
    pieces.push(Piece::Text(&text[begin..]));
    pieces.retain(|piece| *piece != Piece::Text(""));
    Ok(pieces)
}

/// The template that stands for `text` itself.
pub(super) fn literal(text: &str) -> String {
    let mut literal = String::with_capacity(text.len());
    let mut begin = 0;
    while let Some(Mark { open, close, name, .. }) = mark(text, begin) {
        literal.push_str(&text[begin..open]);
        literal.extend(["{{", name, "}}"]);
        begin = close + 1;
    }
    literal.push_str(&text[begin..]);
    literal
}

/// The name in the braces that open at `open`; `None` where the braces contain something else.
fn braced(text: &str, open: usize) -> Option<Range<usize>> {
    let rest = &text[open + 1..];
    let end = rest.find(|c: char| !(c.is_ascii_alphanumeric() || "_-./".contains(c)))?;
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

/// A name that has the form of an input or output but is spelt almost like it, or a word that stands for nothing here. Words
/// that only resemble one (`{speed}`) are the program's own.
fn is_slip(name: &str) -> bool {
    let near = |first: &str| {
        ["inputs", "outputs"].iter().any(|word| strsim::damerau_levenshtein(first, word) <= 1)
            || ["checkpoint", "checkpoints", "seed"].contains(&first)
    };
    match name.split_once('.') {
        _ if name.starts_with("checkpoints/") => true,
        Some((first, _)) => near(first),
        None => ["input", "inputs", "output", "outputs", "checkpoint"].contains(&name),
    }
}

/// True where the piece `at` is a word of its own in the eyes of a shell or an interpreter: nothing but blanks, quotes,
/// parentheses and operators of a shell stand beside it.
pub(super) fn is_word(pieces: &[Piece<'_>], at: usize) -> bool {
    let beside = |c: char| c.is_whitespace() || "\"'`();|&<>".contains(c);
    let is_end = |piece: Option<&Piece<'_>>, last: fn(&str) -> Option<char>| match piece {
        None => true,
        Some(Piece::Text(text)) => last(text).is_none_or(beside),
        Some(_) => false,
    };
    let before = at.checked_sub(1).and_then(|before| pieces.get(before));
    is_end(before, |text| text.chars().next_back()) && is_end(pieces.get(at + 1), |text| text.chars().next())
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
            ("${seed} $${inputs.a} $ {seed}", "${seed} $${inputs.a} $ <seed>"),
            ("{speed} {sed} {seeds} {feed.x}", "{speed} {sed} {seeds} {feed.x}"),
            ("{{input.a}} {{inputs}} {{speed}}", "{input.a} {inputs} {{speed}}"),
            ("{a/b} {seed/2} {{outputs.a/b.svg}}", "{a/b} {seed/2} {outputs.a/b.svg}"),
        ] {
            assert_eq!(shown(text), expected, "{text}");
        }
    }

    #[test]
    fn a_misspelt_placeholder_is_refused() {
        for text in [
            "{input.raw}",
            "{inptus.a}",
            "{input}",
            "{inputs}",
            "{output}",
            "{outputs}",
            "{outputs.}",
            "{output.x}",
            "{checkpoint}",
            "{seed.x}",
            "{inputs.a.b}",
            "{outputs.plots/x.svg}",
            "{inputs.data/}",
            "{checkpoints/last}",
        ] {
            assert!(shown(text).starts_with("error: `{"), "{text}: {}", shown(text));
        }
    }

    #[test]
    fn a_word_of_its_own_stands_between_blanks_quotes_and_operators() {
        let is_word = |text: &str| {
            let pieces = pieces(text).unwrap();
            let at = pieces.iter().position(|piece| matches!(piece, Piece::Input(_))).unwrap();
            is_word(&pieces, at)
        };
        for text in [
            "{inputs.a}",
            "cat {inputs.a} | wc",
            "'{inputs.a}'",
            "x=\"{inputs.a}\"",
            "$(cat {inputs.a})",
            "all=({inputs.a});",
        ] {
            assert!(is_word(text), "{text}");
        }
        for text in [
            "--data={inputs.a}",
            "{inputs.a}/*",
            "-I{inputs.a}",
            "{inputs.a},",
            "{seed}{inputs.a}",
            "a:{inputs.a}",
        ] {
            assert!(!is_word(text), "{text}");
        }
    }

    fn part() -> impl Strategy<Value = &'static str> {
        prop::sample::select(vec![
            "{", "}", "{{", "}}", "$", "seed", "inputs.a", "input", "output.x", "x", " ü", ".", "/",
        ])
    }

    proptest! {
        #[test]
        fn a_literal_stands_for_its_text_and_nothing_else(parts in prop::collection::vec(part(), 0..12)) {
            let text = parts.concat();
            let literal = literal(&text);
            let read = pieces(&literal);
            prop_assert!(read.is_ok(), "{literal}");
            let texts: Option<String> = read
                .unwrap_or_default()
                .iter()
                .map(|piece| if let Piece::Text(text) = piece { Some(*text) } else { None })
                .collect();
            prop_assert_eq!(texts, Some(text));
        }

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
