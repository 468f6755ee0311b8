//! What can go wrong in `cargo xtask`, with a remedy for everything that a user can fix.

use std::fmt;
use std::io;
use std::path::PathBuf;

/// A command's failure. `Display` states what was seen; [`Error::hints`] what to do.
#[derive(Debug)]
pub enum Error {
    /// A command or argument that does not exist.
    Usage { unknown: String },
    /// A file or folder could not be read or written.
    Io { action: &'static str, path: PathBuf, source: io::Error },
    /// A program could not be started.
    Start { program: String, source: io::Error },
    /// A program ran and failed; its own message is already on the terminal.
    Failed { command: String, code: Option<i32> },
    /// Something that the host has to provide is missing or too old.
    Host { problem: String, remedy: String },
    /// The libtorch that the user names cannot be used.
    Libtorch { problem: String, remedy: String },
    /// Some steps of `cargo xtask test` failed.
    Steps { failed: Vec<&'static str> },
}

impl Error {
    /// Closes over what was attempted, for `map_err`.
    pub fn io(action: &'static str, path: impl Into<PathBuf>) -> impl FnOnce(io::Error) -> Self {
        let path = path.into();
        move |source| Self::Io { action, path, source }
    }

    /// 2 for a wrong command line, the code of a failed program, otherwise 1.
    pub fn exit_code(&self) -> u8 {
        match self {
            Self::Usage { .. } => 2,
            Self::Failed { code: Some(code), .. } => u8::try_from(*code).unwrap_or(1),
            _ => 1,
        }
    }

    /// Remedies, each a line of its own.
    pub fn hints(&self) -> Vec<String> {
        match self {
            Self::Usage { .. } => vec!["`cargo xtask help` lists the commands".to_owned()],
            Self::Host { remedy, .. } | Self::Libtorch { remedy, .. } => vec![remedy.clone()],
            Self::Io { source, .. } if source.kind() == io::ErrorKind::StorageFull => {
                vec!["free some disk space and run the command again".to_owned()]
            }
            _ => Vec::new(),
        }
    }
}

impl fmt::Display for Error {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Usage { unknown } => write!(f, "unknown command or argument `{unknown}`"),
            Self::Io { action, path, source } => write!(f, "cannot {action} `{}`: {source}", path.display()),
            Self::Start { program, source } => write!(f, "cannot start `{program}`: {source}"),
            Self::Failed { command, code: Some(code) } => {
                write!(f, "`{command}` ended with exit code {code}")
            }
            Self::Failed { command, code: None } => write!(f, "`{command}` was ended by a signal"),
            Self::Host { problem, .. } | Self::Libtorch { problem, .. } => f.write_str(problem),
            Self::Steps { failed } => write!(f, "failed: {}", failed.join(", ")),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_exit_code_of_a_failed_program_is_passed_on() {
        let failed = |code| Error::Failed { command: "x".to_owned(), code };
        assert_eq!(failed(Some(4)).exit_code(), 4);
        assert_eq!(failed(Some(-1)).exit_code(), 1);
        assert_eq!(failed(None).exit_code(), 1);
    }

    #[test]
    fn a_full_disk_has_a_remedy() {
        let error = Error::io("write", "a")(io::Error::from(io::ErrorKind::StorageFull));
        assert_eq!(error.hints().len(), 1);
    }
}
