//! The environments: CarRacing and LunarLander on rapier2d, their pictures and the episode format.
//!
//! - [`Env`] is the contract; [`EnvConfig`] is `env:` of the pipeline file and builds one; [`VecEnv`] steps several.
//! - [`car_racing`] and [`lunar_lander`] are the games, [`preprocess`] what the thesis makes of CarRacing's picture,
//!   [`FrameStack`] its history.
//! - [`Demonstrations`] is the file format of recorded episodes.
//! - [`gymnasium`] is the bridge to environments in Python.
//! - [`film`] makes films of episodes.
//! - [`check`] compares the games with recordings of the originals; [`command`] does it from the command line.
//! - [`Drive`] is the one stage kind of this package: laps of a scripted driver.
//!
//! Randomness comes from the episode's seed only; nothing depends on threads or time. No libtorch here.

pub mod area;
mod artifacts;
pub mod car_racing;
pub mod check;
pub mod command;
mod config;
pub mod convex;
pub mod coverage;
mod demos;
mod drive;
mod env;
mod error;
pub mod film;
pub mod gymnasium;
pub mod lunar_lander;
mod mass;
mod picture;
mod played;
pub mod preprocess;
pub mod raster;
mod stack;
pub mod surface;
mod vec_env;

pub use artifacts::DEMONSTRATIONS;
pub use config::{CarRacingConfig, CarRacingVersion, EnvConfig, LunarLanderConfig};
pub use demos::{ActionRange, Demonstrations, DemosError, DemosHeader, Episode};
pub use drive::{Drive, DriveParams};
pub use env::{
    ActionSpace, Env, EnvSnapshot, Frame, MapLine, ObservationSpace, Outcome, OwnedFrame, Pose, Step,
};
pub use error::EnvError;
pub use picture::Picture;
pub use stack::FrameStack;
pub use vec_env::{FinishedEpisode, VecEnv, VecEnvSlotSnapshot, VecEnvSnapshot, VecStep};

use dril_stage_api::Kind;

/// The stage kind of this crate.
pub const KINDS: [Kind; 1] = [Kind::of::<Drive>()];
