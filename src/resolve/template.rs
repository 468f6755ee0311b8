//! The `$` of the language: `$path` alone, `${path}` alone or inside a text, `$$` for a dollar.

use std::ops::Range;

/// A parsed text.
#[derive(Debug, PartialEq, Eq)]
pub(super) enum Template<'t> {
    /// No `$` in it.
    Plain,
    /// Only a path: the value itself, of any type.
    Exact(Path<'t>),
    /// Text with values in it.
    Mixed(Vec<Piece<'t>>),
}

/// A piece of a [`Template::Mixed`].
#[derive(Debug, PartialEq, Eq)]
pub(super) enum Piece<'t> {
    Text(&'t str),
    Path(Path<'t>),
}

/// A dotted path: `expert.policy` of `$expert.policy`.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(super) struct Path<'t> {
    /// Without `$` and braces.
    pub text: &'t str,
    /// With them, in bytes of the whole text.
    pub range: Range<usize>,
}

/// How to treat a `$` inside a longer text that starts neither `$$` nor `${`.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Lone {
    /// An error: otherwise `$name` in the middle of a text would silently stay as it is.
    Refuse,
    /// Part of the text: input references have their own meaning for it.
    Keep,
}

/// An invalid `$`.
#[derive(Debug, PartialEq, Eq)]
pub(super) struct BadTemplate {
    pub range: Range<usize>,
    pub message: String,
    pub hint: String,
}

/// Parses a text.
pub(super) fn parse(text: &str, lone: Lone) -> Result<Template<'_>, BadTemplate> {
    if !text.contains('$') {
        return Ok(Template::Plain);
    }
    if let Some(path) = text.strip_prefix('$').filter(|path| is_path(path)) {
        return Ok(Template::Exact(Path { text: path, range: 0..text.len() }));
    }
    let mut pieces = pieces(text, lone)?;
    if let [Piece::Path(path)] = pieces.as_mut_slice() {
        return Ok(Template::Exact(path.clone()));
    }
    Ok(Template::Mixed(pieces))
}

fn pieces(text: &str, lone: Lone) -> Result<Vec<Piece<'_>>, BadTemplate> {
    let mut pieces = Vec::new();
    let (mut begin, mut at) = (0, 0);
    while let Some(dollar) = text[at..].find('$').map(|found| at + found) {
        let rest = &text[dollar + 1..];
        let end = if rest.starts_with('$') {
            // The text up to and including one dollar; the second is skipped.
            pieces.push(Piece::Text(&text[begin..=dollar]));
            dollar + 2
        } else if rest.starts_with('{') {
            let path = braced(text, dollar)?;
            pieces.push(Piece::Text(&text[begin..dollar]));
            let end = path.range.end;
            pieces.push(Piece::Path(path));
            end
        } else if lone == Lone::Keep {
            at = dollar + 1;
            continue;
        } else {
            return Err(lone_dollar(text, dollar));
        };
        (begin, at) = (end, end);
    }
    pieces.push(Piece::Text(&text[begin..]));
    pieces.retain(|piece| *piece != Piece::Text(""));
    Ok(pieces)
}

fn braced(text: &str, dollar: usize) -> Result<Path<'_>, BadTemplate> {
    let begin = dollar + 2;
    let Some(end) = text[begin..].find('}').map(|found| begin + found) else {
        return Err(BadTemplate {
            range: dollar..text.len(),
            message: "found `${` without a `}`".to_owned(),
            hint: "write `${name}`, or `$$` for a dollar".to_owned(),
        });
    };
    let path = &text[begin..end];
    if is_path(path) {
        return Ok(Path { text: path, range: dollar..end + 1 });
    }
    Err(BadTemplate {
        range: dollar..end + 1,
        message: format!(
            "found `${{{}}}`, expected the name of an axis or a param in the braces",
            crate::spec::node::shorten(path)
        ),
        hint: "a path consists of names and dots, as in `${expert.policy}`; there is no arithmetic"
            .to_owned(),
    })
}

fn lone_dollar(text: &str, dollar: usize) -> BadTemplate {
    let rest = &text[dollar + 1..];
    let length = rest.find(|c: char| !(c.is_ascii_alphanumeric() || "-_.".contains(c))).unwrap_or(rest.len());
    let name = rest[..length].trim_end_matches(['.', '-', '_']);
    BadTemplate {
        range: dollar..dollar + 1 + name.len(),
        message: "found a `$` without a meaning".to_owned(),
        hint: if is_path(name) {
            format!("inside a longer text, write a value as `${{{name}}}` and a dollar as `$$`")
        } else {
            "write `${name}` for a value, or `$$` for a dollar".to_owned()
        },
    }
}

/// Names with dots between them; the first begins with a letter.
pub(super) fn is_path(text: &str) -> bool {
    text.starts_with(|c: char| c.is_ascii_alphabetic())
        && text.split('.').all(|name| {
            !name.is_empty() && name.chars().all(|c| c.is_ascii_alphanumeric() || c == '-' || c == '_')
        })
}

#[cfg(test)]
mod tests {
    use super::*;

    fn shown(text: &str) -> String {
        match parse(text, Lone::Refuse) {
            Ok(Template::Plain) => "plain".into(),
            Ok(Template::Exact(path)) => format!("exact {}", path.text),
            Ok(Template::Mixed(pieces)) => {
                let shown = pieces.iter().map(|piece| match piece {
                    Piece::Text(text) => (*text).to_owned(),
                    Piece::Path(path) => {
                        assert!(text[path.range.clone()].starts_with("${"));
                        format!("<{}>", path.text)
                    }
                });
                shown.collect()
            }
            Err(error) => format!("error at {:?}", &text[error.range]),
        }
    }

    #[test]
    fn a_text_is_taken_apart_at_its_dollars() {
        for (text, expected) in [
            ("no dollar", "plain"),
            ("$car", "exact car"),
            ("$car.car-racing.time_limit", "exact car.car-racing.time_limit"),
            ("${car}", "exact car"),
            ("Table of ${expert}: ${n} runs", "Table of <expert>: <n> runs"),
            ("${a}${b}", "<a><b>"),
            ("5 $$", "5 $"),
            ("$$$$", "$$"),
            ("$$name", "$name"),
            ("$${name}", "${name}"),
        ] {
            assert_eq!(shown(text), expected, "{text}");
        }
    }

    #[test]
    fn a_dollar_that_means_nothing_is_refused() {
        for (text, at) in [
            ("$", "$"),
            ("a $name b", "$name"),
            ("$5", "$5"),
            ("${", "${"),
            ("${a", "${a"),
            ("${}", "${}"),
            ("${a+1}", "${a+1}"),
            ("$a.", "$a"),
            ("$a..b", "$a..b"),
            ("$ä", "$"),
        ] {
            assert_eq!(shown(text), format!("error at {at:?}"), "{text}");
        }
    }

    #[test]
    fn wiring_keeps_a_lone_dollar_for_itself() {
        let parsed = parse("dril[seed=$seed].${out}", Lone::Keep).unwrap();
        let Template::Mixed(pieces) = parsed else { panic!("{parsed:?}") };
        assert_eq!(pieces[0], Piece::Text("dril[seed=$seed]."));
    }
}
