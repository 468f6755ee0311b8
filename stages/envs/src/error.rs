//! How an environment refuses: every error says what was seen and what was expected.

use crate::gymnasium::GymnasiumError;

/// Why an environment could not be built, reset, stepped, drawn or restored.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum EnvError {
    /// A field of the configuration is out of range.
    #[error("`{field}`: {message}")]
    Config {
        /// Dotted path of the field, as in `car-racing.time_limit`.
        field: String,
        /// What was seen and what was expected.
        message: String,
    },
    /// An action with the wrong number of values.
    #[error("the action has {seen} values, expected {expected}")]
    ActionLength {
        /// Values given.
        seen: usize,
        /// Values that the action space has.
        expected: usize,
    },
    /// An action that is not a number.
    #[error("action dimension {dimension} is NaN, expected a number (values outside [-1, 1] are clamped)")]
    ActionNan {
        /// Index of the value.
        dimension: usize,
    },
    /// A choice that there is not.
    #[error("the action is {chosen}, expected a whole number from 0 to {}", .choices - 1)]
    Choice {
        /// The action given.
        chosen: f32,
        /// How many there are to choose from.
        choices: usize,
    },
    /// A step before the first reset.
    #[error("`step` before `reset`: start an episode first")]
    NotStarted,
    /// A step after the episode's end.
    #[error("`step` after the end of the episode (step {length}): call `reset` first")]
    Over {
        /// Steps that the episode had.
        length: usize,
    },
    /// The random draws never gave a closed track.
    #[error("no closed track in {attempts} attempts: the track draws are not uniform random numbers")]
    NoTrack {
        /// Attempts made.
        attempts: usize,
    },
    /// A snapshot that this environment cannot have made.
    #[error("cannot restore the snapshot: {0}")]
    Snapshot(String),
    /// A picture size or a file that cannot be made.
    #[error("cannot draw: {0}")]
    Picture(String),
    /// The worker threads could not be started.
    #[error("cannot start {threads} environment threads: {message}")]
    Threads {
        /// Threads asked for.
        threads: usize,
        /// The system's answer.
        message: String,
    },
    /// The bridge to Gymnasium.
    #[error(transparent)]
    Gymnasium(#[from] GymnasiumError),
    /// One of several environments failed.
    #[error("environment {index}: {source}")]
    Worker {
        /// Its index.
        index: usize,
        /// What happened there.
        source: Box<EnvError>,
    },
}
