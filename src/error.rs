//! The top-level error of the program: what failed, and how to fix it. Its kind decides the exit code.

use std::fmt;

use crate::exec::ExecError;
use crate::fsx::FsError;
use crate::plan::PlanError;
use crate::resolve::NoStage;
use crate::spec::Diagnostics;
use crate::store::StoreError;

/// The exit codes. They are stable: scripts may rely on them.
pub mod exit_codes {
    /// Success.
    pub const OK: u8 = 0;
    /// A stage failed; stages that do not depend on it were run.
    pub const STAGE_FAILED: u8 = 1;
    /// Invalid command line.
    pub const USAGE: u8 = 2;
    /// Invalid pipeline file, or a file that it names is missing. Nothing ran.
    pub const PIPELINE: u8 = 3;
    /// The cache, the results folder or another file cannot be read or written, or an executable is missing.
    pub const IO: u8 = 4;
    /// A check failed: the cache is damaged, or results differ from the lock file or from an earlier run.
    pub const CHECK_FAILED: u8 = 5;
    /// The time limit of `run --for` was reached; the next run resumes.
    pub const OUT_OF_TIME: u8 = 6;
    /// Stopped by SIGINT, SIGTERM or SIGHUP; the next run resumes.
    pub const INTERRUPTED: u8 = 130;
}

/// The category of an error, which decides the exit code.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum ErrorKind {
    /// [`exit_codes::USAGE`].
    Usage,
    /// [`exit_codes::PIPELINE`].
    Pipeline,
    /// [`exit_codes::IO`].
    Io,
    /// [`exit_codes::CHECK_FAILED`].
    Check,
}

impl ErrorKind {
    /// See [`exit_codes`].
    pub fn exit_code(self) -> u8 {
        match self {
            Self::Usage => exit_codes::USAGE,
            Self::Pipeline => exit_codes::PIPELINE,
            Self::Io => exit_codes::IO,
            Self::Check => exit_codes::CHECK_FAILED,
        }
    }

    /// Its name in `--json` output.
    pub fn name(self) -> &'static str {
        match self {
            Self::Usage => "usage",
            Self::Pipeline => "pipeline",
            Self::Io => "io",
            Self::Check => "check",
        }
    }
}

/// Why a command failed. Displays as the full text for the terminal: each problem after `error:`, remedies after `hint:`.
#[derive(Debug)]
pub struct Error {
    kind: ErrorKind,
    source: Box<dyn std::error::Error + Send + Sync>,
    hints: Vec<String>,
}

impl Error {
    /// An error of this kind.
    pub fn new(kind: ErrorKind, source: impl Into<Box<dyn std::error::Error + Send + Sync>>) -> Self {
        Self { kind, source: source.into(), hints: Vec::new() }
    }

    /// Adds a remedy.
    #[must_use]
    pub fn hint(mut self, hint: impl Into<String>) -> Self {
        self.hints.push(hint.into());
        self
    }

    /// Its category.
    pub fn kind(&self) -> ErrorKind {
        self.kind
    }

    /// The message without `error:` and hints.
    pub fn message(&self) -> String {
        self.source.to_string().trim_end().to_owned()
    }
}

impl fmt::Display for Error {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let text = self.message();
        if self.source.is::<Diagnostics>() {
            // These write `error:` before every problem themselves.
            writeln!(f, "{text}")?;
        } else if let Some(PlanError::Files(files)) = self.source.downcast_ref() {
            for file in files {
                writeln!(f, "error: {file}")?;
            }
        } else {
            writeln!(f, "error: {text}")?;
        }
        for hint in &self.hints {
            writeln!(f, "  = hint: {hint}")?;
        }
        Ok(())
    }
}

impl std::error::Error for Error {
    fn source(&self) -> Option<&(dyn std::error::Error + 'static)> {
        Some(&*self.source)
    }
}

impl From<Diagnostics> for Error {
    fn from(error: Diagnostics) -> Self {
        Self::new(ErrorKind::Pipeline, error)
    }
}

impl From<FsError> for Error {
    fn from(error: FsError) -> Self {
        Self::new(ErrorKind::Io, error)
    }
}

impl From<StoreError> for Error {
    fn from(error: StoreError) -> Self {
        Self::new(ErrorKind::Io, error).hint("use another cache folder with `--cache DIR` or DRIL_PIPE_CACHE")
    }
}

impl From<NoStage> for Error {
    fn from(error: NoStage) -> Self {
        Self::new(ErrorKind::Usage, error.message).hint(error.hint)
    }
}

impl From<PlanError> for Error {
    fn from(error: PlanError) -> Self {
        match error {
            PlanError::Store(error) => error.into(),
            files @ PlanError::Files(_) => Self::new(ErrorKind::Pipeline, files)
                .hint("paths are relative to the folder of the pipeline file"),
            other => Self::new(ErrorKind::Pipeline, other),
        }
    }
}

impl From<ExecError> for Error {
    fn from(error: ExecError) -> Self {
        match error {
            ExecError::Store(error) => error.into(),
            ExecError::InsufficientResource(error) => {
                let hint = format!("set the number of units: `--resources {}={}`", error.name, error.wanted);
                Self::new(ErrorKind::Usage, error).hint(hint)
            }
            other => Self::new(ErrorKind::Io, other),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_error_has_a_message_and_hints() {
        let error = Error::new(ErrorKind::Io, "cannot write `results`: disk full").hint("free disk space");
        assert_eq!(
            error.to_string(),
            "error: cannot write `results`: disk full\n  = hint: free disk space\n"
        );
        assert_eq!(error.kind().exit_code(), exit_codes::IO);
    }

    #[test]
    fn no_two_kinds_of_ending_share_an_exit_code() {
        use exit_codes::*;
        let codes = [OK, STAGE_FAILED, USAGE, PIPELINE, IO, CHECK_FAILED, OUT_OF_TIME, INTERRUPTED];
        let different: std::collections::BTreeSet<_> = codes.iter().collect();
        assert_eq!(different.len(), codes.len());
    }
}
