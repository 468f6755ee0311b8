//! Parses YAML text to a [`Spec`]: the contents of the pipeline file, each value with its place. Pure: no I/O.
//!
//! [`parse`] fails only if there is no tree of values. Other problems are kept in the [`Spec`] and reported by
//! [`crate::resolve::resolve`] together with its own, so that a user sees all of them at once.
//!
//! `include` reads included files, `yaml` parses text to `node`s (with `scalar` and `syntax`; large files in `pieces`, with a `memo`
//! of known ones), `decode`, `matrix` and `layer` decode those to the `model`; `problem` collects problems, `diagnostic` shows them.

mod decode;
mod diagnostic;
mod fields;
pub(crate) mod include;
pub(crate) mod layer;
pub(crate) mod limits;
mod matrix;
mod memo;
pub(crate) mod model;
pub(crate) mod names;
pub(crate) mod node;
mod pieces;
pub(crate) mod problem;
mod scalar;
mod schema;
pub(crate) mod source;
mod syntax;
pub(crate) mod yaml;

pub(crate) use dril_stage_api::suggest;

pub use diagnostic::{Diagnostic, Diagnostics, Place};
pub use limits::{Limits, Resources};
pub use memo::Memo;
pub use model::Spec;
#[doc(hidden)]
pub use pieces::pieces_agree;
pub use schema::schema;

use node::Value;
use problem::Problem;
use source::Span;

/// The maximum size of a file: positions are 32 bits.
const MAX_BYTES: usize = 64 << 20;

/// The pipeline file's name in messages: `pipelines/thesis.yaml`.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct SourceName(pub String);

/// Parses a pipeline file without includes.
///
/// # Errors
/// The text is not YAML, or not a map. Other problems are reported by [`crate::resolve::resolve`].
pub fn parse(text: &str, name: &SourceName) -> Result<Spec, Diagnostics> {
    parse_bytes(text.as_bytes(), name)
}

/// Parses the bytes of a pipeline file without includes.
///
/// # Errors
/// As [`parse`]; also bytes that are not UTF-8.
pub fn parse_bytes(bytes: &[u8], name: &SourceName) -> Result<Spec, Diagnostics> {
    parse_with(bytes, name, &mut |_| Err(std::io::Error::other("files cannot be read here")))
}

/// Parses the bytes of a pipeline file. `load` reads an included file, by its path relative to the folder of the pipeline file.
///
/// # Errors
/// As [`parse_bytes`].
pub fn parse_with(bytes: &[u8], name: &SourceName, load: &mut Load<'_>) -> Result<Spec, Diagnostics> {
    include::Reader::new(name, load, None).read(bytes)
}

/// As [`parse_with`], with the same result in less time if `memo` has the stages; new stages are added to it.
///
/// # Errors
/// As [`parse_bytes`].
pub fn parse_remembering(
    bytes: &[u8],
    name: &SourceName,
    load: &mut Load<'_>,
    memo: &mut Memo,
) -> Result<Spec, Diagnostics> {
    include::Reader::new(name, load, Some(memo)).read(bytes)
}

/// Reads a file for [`parse_with`].
pub type Load<'l> = dyn FnMut(&str) -> Result<Vec<u8>, std::io::Error> + 'l;

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
