//! Errors of a stage.

use std::path::{Path, PathBuf};

use crate::ParamProblem;

/// Why a stage did not finish.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum StageError {
    /// The stage was asked to stop and stopped cleanly (after a checkpoint, if it supports them). Not a failure.
    #[error("stopped on request")]
    Cancelled,
    /// The job's parameters do not match the kind. The engine checks them before it starts a stage, so the job file was
    /// written by another version.
    #[error("parameters do not match this kind: {0}")]
    Params(String),
    /// An unknown port, or a number of artifacts that the port does not accept.
    #[error("{0}")]
    Port(String),
    /// An input whose content the stage cannot read.
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
        /// The failed operation, as in "cannot write".
        action: &'static str,
        /// The file.
        path: PathBuf,
        /// The operating system's error.
        source: std::io::Error,
    },
    /// The stage failed; the message says what was seen, what was expected and how to fix it.
    #[error("{0}")]
    Failed(String),
}

impl StageError {
    pub(crate) fn params(problems: Vec<ParamProblem>) -> Self {
        let lines: Vec<String> =
            problems.iter().map(|p| format!("{}: {}", p.path.join("."), p.message)).collect();
        Self::Params(lines.join("; "))
    }

    /// A failure with this message.
    pub fn failed(message: impl std::fmt::Display) -> Self {
        Self::Failed(message.to_string())
    }

    /// An unusable input.
    pub fn input(port: &str, path: &Path, message: impl std::fmt::Display) -> Self {
        Self::Input { port: port.to_owned(), path: path.to_owned(), message: message.to_string() }
    }

    /// An I/O error on `path`, for `map_err`.
    pub fn io(action: &'static str, path: &Path) -> impl FnOnce(std::io::Error) -> Self {
        let path = path.to_owned();
        move |source| Self::Io { action, path, source }
    }
}
