//! How a stage fails.

use std::path::{Path, PathBuf};

use crate::ParamProblem;

/// Why a stage did not finish.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum StageError {
    /// Asked to stop, and stopped cleanly (after a checkpoint, where the stage keeps them). Not a failure.
    #[error("stopped on request")]
    Cancelled,
    /// The job's parameters do not fit the kind. The engine checks before it starts a stage, so this is a job file that
    /// another version wrote.
    #[error("parameters do not fit this kind: {0}")]
    Params(String),
    /// A port that the kind does not have, or a number of artifacts that the port does not take.
    #[error("{0}")]
    Port(String),
    /// An input whose content is not what the stage can read.
    #[error("input `{port}` ({path}): {message}", path = path.display())]
    Input {
        /// The input's name.
        port: String,
        /// Its file.
        path: PathBuf,
        /// What was seen and what was expected.
        message: String,
    },
    /// Reading or writing failed.
    #[error("{action} {path}: {source}", path = path.display())]
    Io {
        /// What was tried, as in "cannot write".
        action: &'static str,
        /// The file.
        path: PathBuf,
        /// The system's answer.
        source: std::io::Error,
    },
    /// The work itself failed; the text says what was seen, what was expected and how to mend it.
    #[error("{0}")]
    Failed(String),
}

impl StageError {
    pub(crate) fn params(problems: Vec<ParamProblem>) -> Self {
        let lines: Vec<String> =
            problems.iter().map(|p| format!("{}: {}", p.path.join("."), p.message)).collect();
        Self::Params(lines.join("; "))
    }

    /// The work itself failed.
    pub fn failed(message: impl std::fmt::Display) -> Self {
        Self::Failed(message.to_string())
    }

    /// An input that cannot be used.
    pub fn input(port: &str, path: &Path, message: impl std::fmt::Display) -> Self {
        Self::Input { port: port.to_owned(), path: path.to_owned(), message: message.to_string() }
    }

    /// For `map_err` on a read or write of `path`.
    pub fn io(action: &'static str, path: &Path) -> impl FnOnce(std::io::Error) -> Self {
        let path = path.to_owned();
        move |source| Self::Io { action, path, source }
    }
}
