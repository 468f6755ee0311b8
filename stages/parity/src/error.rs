//! Why a comparison could not be made.

use std::path::PathBuf;

use dril_envs::EnvError;

/// Why recordings cannot be compared.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum CheckError {
    /// A file cannot be read.
    #[error("cannot read {path}: {source}", path = path.display())]
    Io {
        /// The file.
        path: PathBuf,
        /// The system's answer.
        source: std::io::Error,
    },
    /// A file is not what it should be.
    #[error("{name}: {message}")]
    Format {
        /// The file, and the array in it.
        name: String,
        /// What was seen and what was expected.
        message: String,
    },
    /// A folder without recordings.
    #[error("{path} holds no recordings: none of {expected} is there", path = path.display())]
    Empty {
        /// The folder.
        path: PathBuf,
        /// Files looked for.
        expected: String,
    },
    /// A game cannot be played: most likely the bridge to Gymnasium.
    #[error(transparent)]
    Env(#[from] EnvError),
}
