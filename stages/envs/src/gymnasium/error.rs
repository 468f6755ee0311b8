//! Errors of the Python bridge, with how to fix them.

use std::path::PathBuf;

/// Why a Gymnasium environment could not be created or stepped.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum GymnasiumError {
    /// The folder for the packages was not configured.
    #[error(
        "there is no folder for the Python packages of Gymnasium; set DRIL_PIPE_VENVS to a writable folder, or \
         DRIL_PIPE_PYTHON to a Python that has them"
    )]
    NoFolder,
    /// Python is missing or too old.
    #[error(
        "{seen}, expected Python {expected} or newer; install it, or set DRIL_PIPE_PYTHON to one that has the packages \
             (`pip install {packages}`)"
    )]
    NoPython {
        /// What was found.
        seen: String,
        /// The oldest supported version.
        expected: &'static str,
        /// The required packages.
        packages: String,
    },
    /// The virtual environment could not be created.
    #[error(
        "cannot create the Python environment for Gymnasium: {message}\nto create it by hand:\n{commands}"
    )]
    Install {
        /// What failed, with the end of the output.
        message: String,
        /// The commands to run.
        commands: String,
    },
    /// A package is missing, or has another version.
    #[error("`{program}` has {seen}, expected {expected}; {fix}")]
    Package {
        /// The Python.
        program: PathBuf,
        /// What is installed.
        seen: String,
        /// What is required.
        expected: String,
        /// How to fix it.
        fix: String,
    },
    /// The worker could not be started.
    #[error(
        "cannot start `{program}`: {message}; set DRIL_PIPE_PYTHON to a Python that has the packages, or leave it unset \
             to create one"
    )]
    Start {
        /// The Python.
        program: PathBuf,
        /// The operating system's error.
        message: String,
    },
    /// Gymnasium does not know the id.
    #[error("Gymnasium has no environment `{id}`: {message}")]
    Unknown {
        /// The requested id.
        id: String,
        /// Gymnasium's message.
        message: String,
    },
    /// The environment cannot be created with these settings, or its spaces are not supported.
    #[error("`{id}` cannot be used: {message}")]
    Refused {
        /// The environment.
        id: String,
        /// Why.
        message: String,
    },
    /// The worker exited.
    #[error("the Python process of `{id}` exited while {doing} ({status}); its last output:\n{words}")]
    Died {
        /// The environment.
        id: String,
        /// The operation.
        doing: &'static str,
        /// Exit status.
        status: String,
        /// The end of its standard error.
        words: String,
    },
    /// The worker does not respond.
    #[error(
        "the Python process of `{id}` did not respond for {seconds} s while {doing}, and was killed; run the stage \
             again; if it hangs at the same place, the environment itself hangs"
    )]
    Hung {
        /// The environment.
        id: String,
        /// The operation.
        doing: &'static str,
        /// The time limit.
        seconds: u64,
    },
    /// An invalid response.
    #[error(
        "the Python process of `{id}` sent an invalid response while {doing}: {message}; it was killed. Something in \
             the environment writes to the worker's streams, or its packages are damaged"
    )]
    Malformed {
        /// The environment.
        id: String,
        /// The operation.
        doing: &'static str,
        /// What was seen and expected.
        message: String,
    },
}
