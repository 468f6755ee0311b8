//! The result of a subcommand of a stage package.

/// A text to print, and the exit code.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Reply {
    /// The result, for standard output; exit code 0.
    Done(String),
    /// As [`Reply::Done`], but negative, such as a failed check; exit code 1.
    Failed(String),
    /// An error, as [`Reply::Usage`], but with exit code 1.
    Refused(String),
    /// Invalid arguments: what was seen and expected, for standard error; hints are lines that start with `  = hint: `. Exit
    /// code 2.
    Usage(String),
    /// A file cannot be read or written, or a program is missing: as [`Reply::Usage`], but with exit code 4.
    Io(String),
}

impl From<Result<String, String>> for Reply {
    /// A text for standard output, or an error.
    fn from(result: Result<String, String>) -> Self {
        result.map_or_else(Self::Refused, Self::Done)
    }
}
