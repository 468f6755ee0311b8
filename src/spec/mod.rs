//! From YAML text to a [`Spec`]: what the pipeline file says, and where each of its values stands. Pure: no I/O.
//!
//! [`parse`] fails only where there is no tree of values to go on with. Mistakes in it are kept in the [`Spec`] and
//! reported by [`crate::resolve::resolve`] together with what that finds, so that a user sees all of them at once.
//!
//! `yaml` turns text into `node`s (with `scalar` and `syntax`), `decode` and `layer` turn those into the `model`;
//! `problem` collects what is wrong, `diagnostic` shows it.

mod decode;
mod diagnostic;
pub(crate) mod layer;
pub(crate) mod limits;
pub(crate) mod model;
pub(crate) mod names;
pub(crate) mod node;
pub(crate) mod problem;
mod scalar;
pub(crate) mod source;
pub(crate) mod suggest;
mod syntax;
pub(crate) mod yaml;

use std::sync::Arc;

pub use diagnostic::{Diagnostic, Diagnostics, Place};
pub use limits::Limits;
pub use model::Spec;

use node::Value;
use problem::{Problem, Problems};
use source::{Source, Sources, Span};

/// Larger files are refused: no person wrote them, and positions are kept in 32 bits.
const MAX_BYTES: usize = 64 << 20;

/// The pipeline file's name as messages show it: `pipelines/thesis.yaml`.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct SourceName(pub String);

/// Reads a pipeline file.
///
/// # Errors
/// The text is no YAML, or no map. Other mistakes are reported by [`crate::resolve::resolve`].
pub fn parse(text: &str, name: &SourceName) -> Result<Spec, Diagnostics> {
    // Some editors put this mark in front; it means nothing in UTF-8.
    let text = text.strip_prefix('\u{feff}').unwrap_or(text);
    let source = Arc::new(Source::file(&name.0, if text.len() > MAX_BYTES { "" } else { text }));
    let mut problems = Problems::default();
    let start = Span::new(0, 0..0);
    if text.len() > MAX_BYTES {
        problems.add(|| {
            Problem::new(start, format!("the file has {} bytes, expected at most {MAX_BYTES}", text.len()))
                .hint("is this a pipeline file? data is brought in by `{ file: path }`")
        });
        return Err(problems.into_diagnostics(&Sources::new(source)));
    }
    let root = yaml::read(text, 0, 0, &mut problems);
    match root {
        Some(root) if matches!(root.value, Value::Map(_)) => {
            Ok(decode::spec(root, name.clone(), source, problems))
        }
        found => {
            // Without a message of its own the reader found no document, or one that is not a map.
            if problems.is_empty() {
                problems.add(|| not_a_map(found.as_ref(), start));
            }
            Err(problems.into_diagnostics(&Sources::new(source)))
        }
    }
}

fn not_a_map(found: Option<&node::Node>, start: Span) -> Problem {
    let hint =
        "the smallest pipeline is `name: my-pipeline` and, below it, `stages: { my-stage: { kind: ... } }`";
    match found.filter(|node| !matches!(node.value, Value::Null)) {
        Some(node) => Problem::new(
            node.span,
            format!("the file holds {}, expected a map with `name` and `stages`", node.describe()),
        )
        .hint(hint),
        None => Problem::new(start, "the file is empty, expected a map with `name` and `stages`").hint(hint),
    }
}

/// Reads a pipeline file from its bytes.
///
/// # Errors
/// As [`parse`]; also bytes that are not UTF-8.
pub fn parse_bytes(bytes: &[u8], name: &SourceName) -> Result<Spec, Diagnostics> {
    match std::str::from_utf8(bytes) {
        Ok(text) => parse(text, name),
        Err(error) => Err(not_utf8(bytes, error.valid_up_to(), name)),
    }
}

fn not_utf8(bytes: &[u8], at: usize, name: &SourceName) -> Diagnostics {
    let end = bytes.len().min(at + 200);
    let start = bytes[..at].iter().rposition(|byte| *byte == b'\n').map_or(0, |newline| newline + 1);
    // The place is found in the text as far as it is one; what follows is shown as replacement characters.
    let text =
        format!("{}{}", String::from_utf8_lossy(&bytes[..at]), String::from_utf8_lossy(&bytes[at..end]));
    let mut problems = Problems::default();
    problems.add(|| {
        let seen = if bytes.starts_with(&[0xff, 0xfe]) || bytes.starts_with(&[0xfe, 0xff]) {
            "the file looks like UTF-16".to_owned()
        } else if bytes[start..end].contains(&0) {
            format!("the file looks binary: byte {} is not text", at + 1)
        } else {
            format!(
                "byte {} (0x{:02x}) is not valid UTF-8",
                at + 1,
                bytes.get(at).copied().unwrap_or_default()
            )
        };
        Problem::new(Span::new(0, at..at + 1), format!("{seen}, expected a text file in UTF-8"))
            .hint("save the file as UTF-8 in your editor")
    });
    problems.into_diagnostics(&Sources::new(Arc::new(Source::file(&name.0, &text))))
}
