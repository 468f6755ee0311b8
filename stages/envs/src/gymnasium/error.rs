//! What can go wrong between this program and the Python that plays, and how to mend it.

use std::path::PathBuf;

/// Why an environment of Gymnasium could not be made or played.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum GymnasiumError {
    /// Nobody has said where the packages are.
    #[error(
        "nothing says where the Python packages of Gymnasium are kept; set DRIL_PIPE_VENVS to a folder that \
         may be written to, or DRIL_PIPE_PYTHON to a Python that has them"
    )]
    NoFolder,
    /// There is no Python, or one that is too old.
    #[error(
        "{seen}, expected Python {expected} or newer; install it, or set DRIL_PIPE_PYTHON to one that has the packages \
             (`pip install {packages}`)"
    )]
    NoPython {
        /// What was found.
        seen: String,
        /// The oldest version that the packages take.
        expected: &'static str,
        /// What it must have.
        packages: String,
    },
    /// The virtual environment could not be made.
    #[error("cannot make the Python environment for Gymnasium: {message}\nto make it by hand:\n{commands}")]
    Install {
        /// What failed, with the end of what was printed.
        message: String,
        /// What to type.
        commands: String,
    },
    /// A package is missing, or has another version.
    #[error("`{program}` has {seen}, expected {expected}; {mend}")]
    Package {
        /// The Python.
        program: PathBuf,
        /// What it has.
        seen: String,
        /// What is needed.
        expected: String,
        /// What to do.
        mend: String,
    },
    /// The worker could not be started.
    #[error(
        "cannot start `{program}`: {message}; set DRIL_PIPE_PYTHON to a Python that has the packages, or leave it unset \
             to have one made"
    )]
    Start {
        /// The Python.
        program: PathBuf,
        /// The system's answer.
        message: String,
    },
    /// Gymnasium does not know the id.
    #[error("Gymnasium has no environment `{id}`: {message}")]
    Unknown {
        /// What was asked for.
        id: String,
        /// Gymnasium's words.
        message: String,
    },
    /// The environment cannot be made with these settings, or shows or takes what no policy here can use.
    #[error("`{id}` cannot be played: {message}")]
    Refused {
        /// The environment.
        id: String,
        /// Why.
        message: String,
    },
    /// The worker ended by itself.
    #[error("the Python that plays `{id}` ended while {doing} ({status}); its last words:\n{words}")]
    Died {
        /// The environment.
        id: String,
        /// What it was asked for.
        doing: &'static str,
        /// How the process ended.
        status: String,
        /// The end of what it wrote to its standard error.
        words: String,
    },
    /// The worker does not answer.
    #[error(
        "the Python that plays `{id}` has not answered for {seconds} s while {doing}, and was killed; run the stage \
             again, and if it hangs at the same place, the environment itself does"
    )]
    Hung {
        /// The environment.
        id: String,
        /// What it was asked for.
        doing: &'static str,
        /// How long it was waited for.
        seconds: u64,
    },
    /// An answer that makes no sense.
    #[error(
        "the Python that plays `{id}` sent a malformed answer while {doing}: {message}; it was killed. Something in \
             the environment writes to the worker's streams, or its packages are damaged"
    )]
    Malformed {
        /// The environment.
        id: String,
        /// What it was asked for.
        doing: &'static str,
        /// What was seen and expected.
        message: String,
    },
}
