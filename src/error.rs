//! The one error at the top of the program: what could not be done, why, and how to mend it. Its kind is its exit code.

/// Why a command did not do what it was asked to.
#[derive(Debug, thiserror::Error)]
#[error("{message}")]
pub struct Error {
    /// Which exit code it ends in.
    pub kind: ErrorKind,
    /// What was seen and what was expected.
    pub message: String,
    /// How to mend it.
    pub hints: Vec<String>,
}

/// What an error is about; see [`ErrorKind::exit_code`].
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum ErrorKind {
    /// The command line is wrong.
    Usage,
    /// The pipeline file is wrong.
    Pipeline,
    /// The store or a file could not be read or written.
    Io,
}
