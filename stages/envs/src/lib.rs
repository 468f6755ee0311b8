//! The environments: CarRacing on rapier2d, its renderer and the episode format.
//!
//! - [`Env`] is the contract; [`EnvConfig`] is `env:` of the pipeline file and builds one; [`VecEnv`] steps several.
//! - [`car_racing`] is the game, [`preprocess`] what the thesis makes of its picture, [`FrameStack`] its history.
//! - [`Demonstrations`] is the file format of recorded episodes.
//! - [`gymnasium`] is the bridge to environments in Python.
//! - [`film`] makes films of episodes.
//! - [`check`] compares the game with recordings of the original.
//!
//! Randomness comes from the episode's seed only; nothing depends on threads or time. No libtorch here.

pub mod area;
pub mod car_racing;
pub mod check;
mod config;
mod demos;
mod env;
mod error;
pub mod film;
pub mod gymnasium;
mod picture;
pub mod preprocess;
mod stack;
mod vec_env;

pub use config::{CarRacingConfig, CarRacingVersion, EnvConfig};
pub use demos::{ActionRange, Demonstrations, DemosError, DemosHeader, Episode};
pub use env::{ActionSpace, Env, EnvSnapshot, Frame, ObservationSpace, Outcome, OwnedFrame, Step};
pub use error::EnvError;
pub use picture::Picture;
pub use stack::FrameStack;
pub use vec_env::{FinishedEpisode, VecEnv, VecEnvSlotSnapshot, VecEnvSnapshot, VecStep};
