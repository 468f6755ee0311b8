//! The environments: CarRacing and LunarLander on rapier2d, a bridge to Gymnasium, and the format of recorded episodes.
//!
//! - [`Env`] is the contract. [`EnvConfig`] is `env:` of the pipeline file and builds an environment; each environment
//!   owns its settings ([`EnvSettings`]) and is registered by one line in `config.rs`.
//! - [`car_racing`] and [`lunar_lander`] are simulated here, each as an [`episode::Game`]; [`gymnasium`] runs Python.
//! - [`wrappers`] are between environment and policy: preprocessing, frame stacking, vectorisation.
//! - [`recordings`] are demonstrations to learn from and videos to look at.
//! - [`drawing`] and [`physics`] are what the games share; [`params`] what stage kinds that play episodes share.
//!
//! Randomness comes from the episode's seed only; nothing depends on threads or time. This crate does not link libtorch.

mod artifacts;
pub mod car_racing;
mod config;
#[cfg(test)]
mod conformance;
pub mod drawing;
mod env;
pub mod episode;
mod error;
pub mod gymnasium;
pub mod lunar_lander;
pub mod params;
pub mod physics;
pub mod recordings;
mod settings;
pub mod wrappers;

pub use artifacts::DEMONSTRATIONS;
pub use car_racing::drive::{Drive, DriveParams};
pub use car_racing::{CarRacingConfig, CarRacingVersion};
pub use config::EnvConfig;
pub use drawing::image::RgbImage;
pub use env::{
    ActionSpace, Env, EnvSnapshot, Frame, MapLine, ObservationSpace, Outcome, OwnedFrame, Pose, Step,
};
pub use error::EnvError;
pub use lunar_lander::LunarLanderConfig;
pub use recordings::{ActionRange, Demonstrations, DemosError, DemosHeader, Episode};
pub use settings::EnvSettings;
pub use wrappers::{FinishedEpisode, FrameStack, VecEnv, VecEnvSlotSnapshot, VecEnvSnapshot, VecStep};

use dril_stage_api::Kind;

/// The stage kinds of this crate.
pub const KINDS: [Kind; 1] = [Kind::of::<Drive>()];
