//! Translates the YAML crate's syntax errors for people who do not know the YAML grammar, with the usual causes.

use serde_saphyr::granit_parser::ErrorKind;

use super::problem::Problem;
use super::source::Span;

const QUOTE: &str = "a text with `[`, `]`, `{`, `}`, `,`, `#` or `: ` in it is written in quotes, as in `scores: \"evaluate[mode=stochastic]\"`";
const INDENT: &str = "keys of one map start in the same column; what belongs to a key is indented further";
const SPACES: &str = "YAML is indented with spaces; set the editor to insert spaces for tabs";

/// The byte to show for an error that was noticed at `at`: a tab itself, not what follows it.
pub(super) fn culprit(kind: &ErrorKind, text: &str, at: usize) -> usize {
    let line = text.get(..at).map_or(0, |before| before.rfind('\n').map_or(0, |newline| newline + 1));
    match text.get(line..at).and_then(|before| before.find('\t')) {
        Some(tab) if is_tab(kind) => line + tab,
        _ => at,
    }
}

fn is_tab(kind: &ErrorKind) -> bool {
    use ErrorKind as E;
    matches!(
        kind,
        E::TabNotAllowed
            | E::TabInBlockIndentation
            | E::TabInIndentation
            | E::TabAtBlockScalarStart
            | E::TabInPlainScalar
    )
}

/// Says what is wrong at `at`.
pub(super) fn explain(kind: &ErrorKind, at: Span) -> Problem {
    let (message, hints) = words(kind);
    let problem = Problem::new(at, message.unwrap_or_else(|| format!("this is not valid YAML: {kind}")));
    hints.iter().fold(problem, |problem, hint| problem.hint(*hint))
}

fn words(kind: &ErrorKind) -> (Option<String>, &'static [&'static str]) {
    use ErrorKind as E;
    let (message, hints): (&str, &'static [&'static str]) = match kind {
        _ if is_tab(kind) => ("found a tab, expected spaces", &[SPACES]),
        E::InvalidIndentation
        | E::ExpectedBlockMappingKey
        | E::ExpectedBlockSequenceEntry
        | E::MappingValueNotAllowed
        | E::MappingKeyNotAllowed
        | E::BlockSequenceEntryNotAllowed
        | E::InvalidSimpleKey
        | E::SimpleKeyExpected
        | E::UnexpectedEofBlockMapping
        | E::InvalidFlowScalarIndent => {
            return (Some(format!("this is not valid YAML here: {}", detail(kind))), &[INDENT, QUOTE]);
        }
        E::ExpectedFlowMappingSeparator | E::UnexpectedEofFlowMapping => {
            ("expected `,` or `}` here: this map in braces is not closed", &[QUOTE])
        }
        E::ExpectedFlowSequenceSeparator | E::UnexpectedEofFlowSequence => {
            ("expected `,` or `]` here: this list in brackets is not closed", &[QUOTE])
        }
        E::UnclosedFlowCollection { open } => {
            return (Some(format!("a `{open}` is never closed")), &["add the closing bracket", QUOTE]);
        }
        E::MisplacedFlowCollectionEnd => ("found a closing bracket that nothing opened", &[QUOTE]),
        E::MismatchedFlowCollectionEnd { open, close } => {
            return (Some(format!("found `{close}`, expected the bracket that closes `{open}`")), &[QUOTE]);
        }
        E::UnclosedQuotedScalar | E::InvalidQuotedScalarIndent | E::DocumentIndicatorInQuotedScalar => {
            ("a quote is never closed, or a quoted text continues here", &["add the closing quote"])
        }
        E::UnknownAnchor => (
            "found a YAML alias `*name` without an anchor `&name` before it",
            &[
                "a text that begins with `*` is written in quotes",
                "shared values belong under `params`, used as `$name`",
            ],
        ),
        E::UnexpectedCharacter { .. } => (
            "found a character that no YAML value may begin with",
            &["a text that begins with `@` or a back-quote is written in quotes"],
        ),
        E::UnknownQuotedScalarEscape => (
            "found an unknown escape after `\\` in a text in double quotes",
            &["write `\\\\` for a backslash, or use single quotes"],
        ),
        E::RecursionLimitExceeded => {
            return (
                Some(format!("lists and maps are more than {} deep here", super::node::MAX_DEPTH)),
                &["is a bracket missing?"],
            );
        }
        _ => return (None, &[]),
    };
    (Some(message.to_owned()), hints)
}

fn detail(kind: &ErrorKind) -> &'static str {
    use ErrorKind as E;
    match kind {
        E::InvalidIndentation | E::InvalidFlowScalarIndent => "the indentation matches no line above",
        E::ExpectedBlockMappingKey => "expected the next key of a map",
        E::ExpectedBlockSequenceEntry => "expected the next `- ` of a list",
        E::MappingValueNotAllowed => "a second `:` in one line",
        E::BlockSequenceEntryNotAllowed => "a `- ` of a list does not fit here",
        E::SimpleKeyExpected | E::InvalidSimpleKey => "expected `:` after a key",
        E::UnexpectedEofBlockMapping => "the file ends in the middle of a map",
        _ => "a key does not fit here",
    }
}
