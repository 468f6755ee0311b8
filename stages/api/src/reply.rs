//! How a subcommand that a stage crate brings along ends.

/// A text, and what the program makes of it.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Reply {
    /// What was asked for, for standard output; the program ends with 0.
    Done(String),
    /// An answer like [`Reply::Done`], but not the one hoped for, as when a check has found something; the program ends
    /// with 1.
    Failed(String),
    /// It could not be done: as [`Reply::Usage`], but the program ends with 1.
    Refused(String),
    /// The arguments are wrong. What was seen and expected, for standard error; ways to mend it are lines that open with
    /// `  = hint: `. The program ends with 2.
    Usage(String),
    /// A file cannot be read or written, or a program is missing: as [`Reply::Usage`], but the program ends with 4.
    Io(String),
}

impl From<Result<String, String>> for Reply {
    /// A text for standard output, or what went wrong.
    fn from(result: Result<String, String>) -> Self {
        result.map_or_else(Self::Refused, Self::Done)
    }
}
