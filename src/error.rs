//! The one error at the top of the program: what could not be done, and how to mend it. Its kind is its exit code.

use std::fmt;

use crate::exec::ExecError;
use crate::fsx::FsError;
use crate::plan::PlanError;
use crate::resolve::NoStage;
use crate::spec::Diagnostics;
use crate::store::StoreError;

/// What the program's exit codes mean. They are stable: scripts may rely on them.
pub mod exit_codes {
    /// Everything that was asked for is done.
    pub const OK: u8 = 0;
    /// A stage failed; what does not depend on it was still done.
    pub const STAGE_FAILED: u8 = 1;
    /// The command line is wrong.
    pub const USAGE: u8 = 2;
    /// The pipeline file is wrong, or a file that it names is not there. Nothing ran.
    pub const PIPELINE: u8 = 3;
    /// The store, the results folder or another file could not be read or written, or a program is missing.
    pub const IO: u8 = 4;
    /// A check did not hold: the store is damaged, or results are not what they were.
    pub const CHECK_FAILED: u8 = 5;
    /// The time of `run --for` was over; the next run goes on from there.
    pub const OUT_OF_TIME: u8 = 6;
    /// Stopped by SIGINT, SIGTERM or SIGHUP; the next run goes on from there.
    pub const INTERRUPTED: u8 = 130;
}

/// What an error is about, and so the exit code that it ends in.
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

/// Why a command did not do what it was asked to. Displays as the full text for the terminal, each problem opened by
/// `error:`, the remedies as `hint:`.
#[derive(Debug)]
pub struct Error {
    kind: ErrorKind,
    source: Box<dyn std::error::Error + Send + Sync>,
    hints: Vec<String>,
}

impl Error {
    /// An error of that kind.
    pub fn new(kind: ErrorKind, source: impl Into<Box<dyn std::error::Error + Send + Sync>>) -> Self {
        Self { kind, source: source.into(), hints: Vec::new() }
    }

    /// Adds how to mend it.
    #[must_use]
    pub fn hint(mut self, hint: impl Into<String>) -> Self {
        self.hints.push(hint.into());
        self
    }

    /// What it is about.
    pub fn kind(&self) -> ErrorKind {
        self.kind
    }

    /// The text of the error alone, without `error:` and hints.
    pub fn message(&self) -> String {
        self.source.to_string().trim_end().to_owned()
    }
}

impl fmt::Display for Error {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let text = self.message();
        if self.source.is::<Diagnostics>() {
            // These open every problem themselves.
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
        Self::new(ErrorKind::Io, error).hint("another store can be given by `--cache DIR` or DRIL_PIPE_CACHE")
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
    fn an_error_says_what_and_how_to_mend_it() {
        let error = Error::new(ErrorKind::Io, "cannot write `results`: disk full").hint("make room");
        assert_eq!(error.to_string(), "error: cannot write `results`: disk full\n  = hint: make room\n");
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
