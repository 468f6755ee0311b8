//! Errors of environments: each says what was seen and what was expected.

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
    /// An action with a NaN.
    #[error("action dimension {dimension} is NaN, expected a number (values outside [-1, 1] are clamped)")]
    ActionNan {
        /// Index of the value.
        dimension: usize,
    },
    /// A discrete action that does not exist.
    #[error("the action is {chosen}, expected a whole number from 0 to {}", .choices - 1)]
    Choice {
        /// The given action.
        chosen: f32,
        /// Number of discrete actions.
        choices: usize,
    },
    /// A step before the first reset.
    #[error("`step` before `reset`: start an episode first")]
    NotStarted,
    /// A step after the episode's end.
    #[error("`step` after the end of the episode (step {length}): call `reset` first")]
    Over {
        /// Length of the episode, in steps.
        length: usize,
    },
    /// The random draws gave no closed track.
    #[error("no closed track in {attempts} attempts: the track draws are not uniform random numbers")]
    NoTrack {
        /// Attempts made.
        attempts: usize,
    },
    /// A snapshot that is not from this environment.
    #[error("cannot restore the snapshot: {0}")]
    Snapshot(String),
    /// Rendering, or writing an image or video, failed.
    #[error("cannot render: {0}")]
    Render(String),
    /// The worker threads could not be started.
    #[error("cannot start {threads} environment threads: {message}")]
    Threads {
        /// Requested number of threads.
        threads: usize,
        /// The operating system's error.
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
        /// Its error.
        source: Box<EnvError>,
    },
}
