//! From YAML text to a [`Spec`]: what the pipeline file says, and where each of its values stands. Pure: no I/O.
//!
//! [`parse`] fails only where there is no tree of values to go on with. Mistakes in it are kept in the [`Spec`] and
//! reported by [`crate::resolve::resolve`] together with what that finds, so that a user sees all of them at once.
//!
//! `include` goes from a file to those that it includes, `yaml` turns text into `node`s (with `scalar` and `syntax`; large
//! files by `pieces`, of which a `memo` knows what they were before), `decode`, `matrix` and `layer` turn those into the `model`;
//! `problem` collects what is wrong, `diagnostic` shows it.

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
pub(crate) mod suggest;
mod syntax;
pub(crate) mod yaml;

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

/// Larger files are refused: no person wrote them, and positions are kept in 32 bits.
const MAX_BYTES: usize = 64 << 20;

/// The pipeline file's name as messages show it: `pipelines/thesis.yaml`.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct SourceName(pub String);

/// Reads a pipeline file that includes no other.
///
/// # Errors
/// The text is no YAML, or no map. Other mistakes are reported by [`crate::resolve::resolve`].
pub fn parse(text: &str, name: &SourceName) -> Result<Spec, Diagnostics> {
    parse_bytes(text.as_bytes(), name)
}

/// Reads a pipeline file from its bytes, one that includes no other.
///
/// # Errors
/// As [`parse`]; also bytes that are not UTF-8.
pub fn parse_bytes(bytes: &[u8], name: &SourceName) -> Result<Spec, Diagnostics> {
    parse_with(bytes, name, &mut |_| Err(std::io::Error::other("files cannot be read here")))
}

/// Reads a pipeline file from its bytes. `load` reads a file that it includes, by its path relative to the folder of the
/// pipeline file.
///
/// # Errors
/// As [`parse_bytes`].
pub fn parse_with(bytes: &[u8], name: &SourceName, load: &mut Load<'_>) -> Result<Spec, Diagnostics> {
    include::Reader::new(name, load, None).read(bytes)
}

/// As [`parse_with`], the same result in less time where `memo` knows the stages, which it is told of otherwise.
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
