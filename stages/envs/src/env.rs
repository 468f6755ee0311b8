//! The contract of an environment: spaces, reset, step, observe, snapshot, render.

use serde::{Deserialize, Serialize};

use crate::{EnvError, RgbImage};

/// Observation space.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case", deny_unknown_fields)]
pub enum ObservationSpace {
    /// Greyscale images, row-major `u8`, row 0 on top. [`Env::frame`] returns only the newest frame; stacking is up to the
    /// consumer (see [`crate::FrameStack`]).
    Image {
        /// Rows.
        height: usize,
        /// Columns.
        width: usize,
        /// Number of stacked frames that a policy sees.
        stack: usize,
    },
    /// Vectors of `f32`.
    Vector {
        /// Length of the vector.
        len: usize,
    },
}

impl ObservationSpace {
    /// Number of values in one frame.
    pub fn frame_len(&self) -> usize {
        match self {
            Self::Image { height, width, .. } => height * width,
            Self::Vector { len } => *len,
        }
    }

    /// Number of stacked frames that a policy sees; 1 for vectors.
    pub fn stack(&self) -> usize {
        match self {
            Self::Image { stack, .. } => *stack,
            Self::Vector { .. } => 1,
        }
    }
}

/// Action space.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case", deny_unknown_fields)]
pub enum ActionSpace {
    /// Continuous actions: `dims` numbers, each in [-1, 1].
    Continuous {
        /// Action dimensions.
        dims: usize,
    },
    /// Discrete actions, numbered from 0.
    Discrete {
        /// Number of actions.
        actions: usize,
    },
}

impl ActionSpace {
    /// Length of the action slice that [`Env::step`] takes; 1 for discrete actions.
    pub fn action_len(&self) -> usize {
        match self {
            Self::Continuous { dims } => *dims,
            Self::Discrete { .. } => 1,
        }
    }

    /// Number of network outputs: one per action dimension, or one logit per discrete action.
    pub fn outputs(&self) -> usize {
        match self {
            Self::Continuous { dims } => *dims,
            Self::Discrete { actions } => *actions,
        }
    }
}

/// State of an episode after a step.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Outcome {
    /// The episode continues.
    Running,
    /// Terminated with success: lap finished, or landed.
    Finished,
    /// Terminated with failure: left the playfield, or crashed.
    Failed,
    /// Truncated at the time limit: the last state is not terminal.
    TimeLimit,
}

impl Outcome {
    /// True if the episode is over.
    pub fn ended(self) -> bool {
        self != Self::Running
    }

    /// True if the last state is terminal, so that its value is 0; false at truncation.
    pub fn terminal(self) -> bool {
        matches!(self, Self::Finished | Self::Failed)
    }
}

/// Result of a step.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Step {
    /// Reward of the environment, unscaled.
    pub reward: f64,
    /// State of the episode.
    pub outcome: Outcome,
}

/// Position, angle and speed of the body that the agent controls, in the environment's own units of length.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Pose {
    /// Along the horizontal axis.
    pub x: f64,
    /// Along the vertical axis, upwards.
    pub y: f64,
    /// Radians, counter-clockwise, not wrapped.
    pub angle: f64,
    /// Units of length per second.
    pub speed: f64,
}

impl Pose {
    /// A pose with the speed of this velocity.
    pub(crate) fn new([x, y]: [f64; 2], angle: f64, [vx, vy]: [f64; 2]) -> Self {
        Self { x, y, angle, speed: (vx * vx + vy * vy).sqrt() }
    }
}

/// A line of the world that does not move during an episode: the side of a track, the ground.
#[derive(Clone, Debug, PartialEq)]
pub struct MapLine {
    /// Its name.
    pub name: &'static str,
    /// Its points in order, in the units of [`Pose`]; a closed line ends with its first point.
    pub points: Vec<[f64; 2]>,
}

/// One observation, without stacked history.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Frame<'a> {
    /// Row-major `u8`, row 0 on top.
    Image(&'a [u8]),
    /// A vector.
    Vector(&'a [f32]),
}

impl Frame<'_> {
    /// An owned copy.
    pub fn to_owned(self) -> OwnedFrame {
        match self {
            Frame::Image(pixels) => OwnedFrame::Image(pixels.to_vec()),
            Frame::Vector(values) => OwnedFrame::Vector(values.to_vec()),
        }
    }
}

/// A [`Frame`] that owns its values.
#[derive(Clone, Debug, PartialEq)]
pub enum OwnedFrame {
    /// Row-major `u8`, row 0 on top.
    Image(Vec<u8>),
    /// A vector.
    Vector(Vec<f32>),
}

impl OwnedFrame {
    /// A borrowed view.
    pub fn as_frame(&self) -> Frame<'_> {
        match self {
            Self::Image(pixels) => Frame::Image(pixels),
            Self::Vector(values) => Frame::Vector(values),
        }
    }
}

/// Everything needed to continue an episode bit-identically: its seed and the actions taken, which are replayed.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct EnvSnapshot {
    /// Seed of the episode; none before the first reset.
    pub seed: Option<u64>,
    /// Actions since the reset, step by step, as the environment used them (clamped).
    pub actions: Vec<f32>,
}

/// An environment, which runs one episode at a time.
///
/// An episode is determined by its seed and the actions; nothing carries over from the previous episode.
pub trait Env: Send {
    /// Space of the observations that [`Env::frame`] returns.
    fn observation_space(&self) -> ObservationSpace;

    /// Space of the actions that [`Env::step`] takes.
    fn action_space(&self) -> ActionSpace;

    /// Starts the episode with this seed; [`Env::frame`] then returns the first observation.
    ///
    /// # Errors
    /// The seed gives no valid start, or the process that runs the environment failed.
    fn reset(&mut self, seed: u64) -> Result<(), EnvError>;

    /// Takes one step. `action`: `dims` values (continuous), clamped to [-1, 1], or one index (discrete).
    ///
    /// # Errors
    /// Wrong length, NaN, no running episode.
    fn step(&mut self, action: &[f32]) -> Result<Step, EnvError>;

    /// Starts the step that the next call of [`Env::step`], with the same action, completes, so that environments in other
    /// processes run in parallel. Does nothing by default.
    ///
    /// # Errors
    /// As [`Env::step`].
    fn begin(&mut self, _action: &[f32]) -> Result<(), EnvError> {
        Ok(())
    }

    /// The newest observation.
    fn frame(&self) -> Frame<'_>;

    /// Snapshot for [`Env::restore`].
    fn snapshot(&self) -> EnvSnapshot;

    /// Restores the episode to the point at which the snapshot was taken.
    ///
    /// # Errors
    /// The snapshot is not from an environment with these settings.
    fn restore(&mut self, snapshot: &EnvSnapshot) -> Result<(), EnvError>;

    /// Renders the current state as an RGB image of `width` x `height` pixels.
    ///
    /// # Errors
    /// An unsupported size, or an environment that cannot render.
    fn render(&mut self, width: usize, height: usize) -> Result<RgbImage, EnvError>;

    /// The pose of the agent's body; `None` if the environment has none, and before the first episode.
    fn pose(&self) -> Option<Pose> {
        None
    }

    /// The lines of the running episode's world; none if the environment has none, and before the first episode.
    fn map(&self) -> Vec<MapLine> {
        Vec::new()
    }
}
