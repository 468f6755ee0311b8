//! From YAML text to a [`Spec`]: what the pipeline file says, and where each of its values stands. Pure: no I/O.

mod diagnostic;

pub use diagnostic::{Diagnostic, Diagnostics};

/// The pipeline file's name as messages show it: `pipelines/thesis.yaml`.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct SourceName(pub String);

/// A pipeline file that was read.
#[derive(Clone, Debug)]
pub struct Spec {
    name: SourceName,
}

/// Reads a pipeline file.
///
/// # Errors
/// All that is wrong with it, each with its place.
pub fn parse(text: &str, name: &SourceName) -> Result<Spec, Diagnostics> {
    let _ = text;
    Ok(Spec { name: name.clone() })
}

impl Spec {
    /// The file that it was read from, as messages show it.
    pub fn source_name(&self) -> &SourceName {
        &self.name
    }
}
