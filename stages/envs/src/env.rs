//! The contract of an environment: reset, step, look, save.

use serde::{Deserialize, Serialize};

use crate::{EnvError, Picture};

/// What observations look like.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case", deny_unknown_fields)]
pub enum ObservationSpace {
    /// A grey picture, row-major `u8`, row 0 on top. [`Env::frame`] is the newest picture only; the consumer stacks
    /// (see [`crate::FrameStack`]).
    Image {
        /// Rows.
        height: usize,
        /// Columns.
        width: usize,
        /// Pictures that a policy sees at once.
        stack: usize,
    },
    /// A vector of `f32`.
    Vector {
        /// Its length.
        len: usize,
    },
}

impl ObservationSpace {
    /// Values in one frame.
    pub fn frame_len(&self) -> usize {
        match self {
            Self::Image { height, width, .. } => height * width,
            Self::Vector { len } => *len,
        }
    }

    /// Frames that a policy sees at once; 1 for vectors.
    pub fn stack(&self) -> usize {
        match self {
            Self::Image { stack, .. } => *stack,
            Self::Vector { .. } => 1,
        }
    }
}

/// What actions look like.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case", deny_unknown_fields)]
pub enum ActionSpace {
    /// `dims` numbers, each in [-1, 1].
    Continuous {
        /// Numbers in an action.
        dims: usize,
    },
    /// One of `actions` choices.
    Discrete {
        /// Number of choices.
        actions: usize,
    },
}

impl ActionSpace {
    /// Values that [`Env::step`] takes.
    pub fn action_len(&self) -> usize {
        match self {
            Self::Continuous { dims } => *dims,
            Self::Discrete { .. } => 1,
        }
    }

    /// Values that a network answers with: one for each number of an action, or one for each choice.
    pub fn outputs(&self) -> usize {
        match self {
            Self::Continuous { dims } => *dims,
            Self::Discrete { actions } => *actions,
        }
    }
}

/// How an episode stands after a step.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Outcome {
    /// It goes on.
    Running,
    /// Lap finished, or landed.
    Finished,
    /// Terminal failure: left the playfield, or crashed.
    Failed,
    /// The time limit was reached: the episode is truncated, its state is not terminal.
    TimeLimit,
}

impl Outcome {
    /// True where the episode is over.
    pub fn ended(self) -> bool {
        self != Self::Running
    }

    /// True where the last state is terminal, so that its value is 0; false at a time limit.
    pub fn terminal(self) -> bool {
        matches!(self, Self::Finished | Self::Failed)
    }
}

/// What a step gave.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Step {
    /// The environment's own reward, unscaled.
    pub reward: f64,
    /// How the episode stands.
    pub outcome: Outcome,
}

/// Where the body that an agent moves is, in the environment's own units of length.
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

/// A line of the world that stays where it is for an episode: the side of a track, the ground.
#[derive(Clone, Debug, PartialEq)]
pub struct MapLine {
    /// What it is.
    pub name: &'static str,
    /// Its points in order, in the units of [`Pose`]; a closed line ends with its first point.
    pub points: Vec<[f64; 2]>,
}

/// One observation without its history.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Frame<'a> {
    /// Row-major `u8`, row 0 on top.
    Image(&'a [u8]),
    /// A vector.
    Vector(&'a [f32]),
}

impl Frame<'_> {
    /// A copy that outlives the environment's next step.
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
    /// The frame.
    pub fn as_frame(&self) -> Frame<'_> {
        match self {
            Self::Image(pixels) => Frame::Image(pixels),
            Self::Vector(values) => Frame::Vector(values),
        }
    }
}

/// All that is needed to continue an episode bit-identically: its seed and the actions taken, which are replayed.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct EnvSnapshot {
    /// The seed of the episode; none before the first reset.
    pub seed: Option<u64>,
    /// The actions since the reset, step by step, as the environment used them (clamped).
    pub actions: Vec<f32>,
}

/// An environment that plays one episode at a time.
///
/// Everything that happens in an episode follows from its seed and the actions: nothing carries over from the episode
/// before.
pub trait Env: Send {
    /// What [`Env::frame`] gives.
    fn observation_space(&self) -> ObservationSpace;

    /// What [`Env::step`] takes.
    fn action_space(&self) -> ActionSpace;

    /// Starts the episode that `seed` names; the first observation is then in [`Env::frame`].
    ///
    /// # Errors
    /// The episode cannot be made.
    fn reset(&mut self, seed: u64) -> Result<(), EnvError>;

    /// Acts once. `action`: `dims` values (continuous) or one index (discrete). Values outside [-1, 1] are clamped.
    ///
    /// # Errors
    /// Wrong length, NaN, no episode, or the episode is over.
    fn step(&mut self, action: &[f32]) -> Result<Step, EnvError>;

    /// Begins the step that the next call of [`Env::step`], with the same action, completes. An environment in another
    /// process works meanwhile; others have nothing to do before the step itself.
    ///
    /// # Errors
    /// As [`Env::step`].
    fn begin(&mut self, _action: &[f32]) -> Result<(), EnvError> {
        Ok(())
    }

    /// The newest observation.
    fn frame(&self) -> Frame<'_>;

    /// What [`Env::restore`] needs.
    fn snapshot(&self) -> EnvSnapshot;

    /// Brings back the episode at the point where the snapshot was taken.
    ///
    /// # Errors
    /// The snapshot is not one of an environment like this.
    fn restore(&mut self, snapshot: &EnvSnapshot) -> Result<(), EnvError>;

    /// A colour picture for people, `width` x `height`.
    ///
    /// # Errors
    /// A size that cannot be drawn, or an environment that has no picture.
    fn render(&mut self, width: usize, height: usize) -> Result<Picture, EnvError>;

    /// Where the agent's body is; `None` where the environment does not say, and before the first episode.
    fn pose(&self) -> Option<Pose> {
        None
    }

    /// The lines of the running episode's world; none where the environment does not say.
    fn map(&self) -> Vec<MapLine> {
        Vec::new()
    }
}

/// The action with its values clamped to [-1, 1].
///
/// # Errors
/// Wrong length, or NaN.
pub(crate) fn checked<const DIMS: usize>(action: &[f32]) -> Result<[f32; DIMS], EnvError> {
    let action: [f32; DIMS] =
        action.try_into().map_err(|_| EnvError::ActionLength { seen: action.len(), expected: DIMS })?;
    match action.iter().position(|value| value.is_nan()) {
        Some(dimension) => Err(EnvError::ActionNan { dimension }),
        None => Ok(action.map(|value| value.clamp(-1.0, 1.0))),
    }
}
