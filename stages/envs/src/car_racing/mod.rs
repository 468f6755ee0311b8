//! CarRacing: a car on a random track, seen from above.
//!
//! Written from the facts of gym's CarRacing-v0 (Klimov, 2016) and Gymnasium's CarRacing-v3, with rapier2d in place of
//! Box2D. [`track`] makes the track, [`car`], [`tyre`] and [`world`] move the car, [`tiles`] sees what it touches,
//! [`simulation`] keeps the score, and [`render`] draws a [`scene`].

pub mod camera;
pub mod car;
mod config;
pub mod drive;
pub mod driver;
mod grass;
mod indicators;
pub mod paint;
pub mod palette;
pub mod positions;
pub mod render;
pub mod scene;
pub mod shape;
pub mod simulation;
pub mod steering_stop;
mod text;
pub mod tiles;
pub mod track;
pub mod tyre;
pub mod world;

use dril_stage_api::Seed;
use rand::Rng;

use crate::episode::{EpisodeRunner, Game, Simulate};
use crate::settings::several;
use crate::wrappers::preprocess::{self, FULL, SIDE};
use crate::{
    ActionSpace, Env, EnvError, EnvSettings, Frame, MapLine, ObservationSpace, Pose, RgbImage, Step,
};
use car::Controls;
pub use config::{CarRacingConfig, CarRacingVersion};
use render::{Output, Renderer};
use simulation::{Rules, Simulation};
use track::{DRAWS, Track};

/// Attempts after which the track draws cannot be uniform: one in ten fails.
const MOST_ATTEMPTS: usize = 1000;

/// CarRacing as the thesis's policies see it: 84 x 84 grey, two actions.
///
/// Action 0 steers, -1 (left) to 1 (right); action 1 is the throttle above 0 and the brake below.
pub struct CarRacing {
    config: CarRacingConfig,
    renderer: Renderer,
    frame: Box<[u8; SIDE * SIDE]>,
    episode: Option<EpisodeRunner<Simulation>>,
}

impl CarRacing {
    /// An environment before its first episode.
    pub fn new(config: CarRacingConfig) -> Self {
        let renderer = Renderer::new(config.version, Output::Grey, [FULL; 2]);
        Self { config, renderer, frame: Box::new([0; SIDE * SIDE]), episode: None }
    }

    /// The track that a seed names.
    ///
    /// # Errors
    /// Never in practice: one attempt in ten fails.
    pub fn track(seed: u64) -> Result<(Track, usize), EnvError> {
        let mut stream = Seed(seed).stream("track");
        let uniform = std::iter::from_fn(|| Some(unit_interval(stream.next_u64())));
        Track::generate(track::scale_draws(uniform.take(DRAWS * MOST_ATTEMPTS)))
            .ok_or(EnvError::NoTrack { attempts: MOST_ATTEMPTS })
    }

    /// The uniform numbers in [0, 1) from which the track of a seed is made: those of the attempt that closed.
    ///
    /// # Errors
    /// As [`CarRacing::track`].
    pub fn track_draws(seed: u64) -> Result<[f64; DRAWS], EnvError> {
        let (_, attempts) = Self::track(seed)?;
        let mut stream = Seed(seed).stream("track");
        let mut draws = [0.0; DRAWS];
        for _ in 0..attempts {
            draws = std::array::from_fn(|_| unit_interval(stream.next_u64()));
        }
        Ok(draws)
    }

    /// The running episode.
    pub fn simulation(&self) -> Option<&Simulation> {
        self.episode.as_ref().map(|episode| &episode.simulation)
    }
}

impl Simulate for Simulation {
    fn advance(&mut self, action: &[f32]) -> Step {
        let [steer, pedal] = [0, 1].map(|value| f64::from(action[value]));
        self.step(&Controls { steer, gas: pedal.max(0.0), brake: (-pedal).max(0.0) })
    }
}

/// The top 53 bits as a number in [0, 1).
fn unit_interval(bits: u64) -> f64 {
    (bits >> 11) as f64 / (1u64 << 53) as f64
}

impl Game for CarRacing {
    type Simulation = Simulation;
    const SPACES: (ObservationSpace, ActionSpace) = (
        ObservationSpace::Image { height: SIDE, width: SIDE, stack: 4 },
        ActionSpace::Continuous { dims: 2 },
    );

    fn simulate(&self, seed: u64) -> Result<Simulation, EnvError> {
        let (track, _) = Self::track(seed)?;
        let rules = Rules { lap_share: self.config.lap_share(), time_limit: self.time_limit() };
        Ok(Simulation::new(track, rules))
    }

    fn time_limit(&self) -> usize {
        self.config.time_limit as usize
    }

    fn episode(&self) -> Option<&EpisodeRunner<Simulation>> {
        self.episode.as_ref()
    }

    fn episode_mut(&mut self) -> &mut Option<EpisodeRunner<Simulation>> {
        &mut self.episode
    }

    fn observe(&mut self) {
        let Some(episode) = &self.episode else { return self.frame.fill(0) };
        self.renderer.draw(episode.simulation.track(), &episode.simulation.scene());
        if let Ok(full) = self.renderer.pixels().try_into() {
            preprocess::shrink(full, &mut self.frame);
        }
    }

    fn observation(&self) -> Frame<'_> {
        Frame::Image(self.frame.as_slice())
    }

    fn draw(&self, simulation: &Simulation, width: usize, height: usize) -> RgbImage {
        let mut renderer = Renderer::averaged(self.config.version, Output::Rgb, [width, height]);
        renderer.draw(simulation.track(), &simulation.scene());
        RgbImage { width, height, rgb: renderer.pixels().to_vec() }
    }

    fn pose_in(&self, simulation: &Simulation) -> Option<Pose> {
        let hull = simulation.car().hull();
        Some(Pose::new(hull.position, simulation.car().world().hull_angle(), hull.velocity))
    }

    fn map_of(&self, simulation: &Simulation) -> Vec<MapLine> {
        let tiles = &simulation.track().tiles;
        let side = |name, corner: usize| MapLine {
            name,
            points: tiles.iter().chain(tiles.first()).map(|tile| tile[corner]).collect(),
        };
        vec![side("left", 0), side("right", 1)]
    }
}

impl EnvSettings for CarRacingConfig {
    fn check(&self) -> Vec<(String, String)> {
        CarRacingConfig::check(self)
    }

    fn build(&self, count: usize, _workers: usize) -> Result<Vec<Box<dyn Env>>, EnvError> {
        Ok(several(count, || CarRacing::new(self.clone())))
    }

    fn known_spaces(&self) -> Option<(ObservationSpace, ActionSpace)> {
        Some(CarRacing::SPACES)
    }

    fn action_labels(&self) -> &'static [&'static str] {
        &["steer", "brake | gas"]
    }

    fn steps_per_second(&self) -> f64 {
        50.0
    }

    fn aspect_ratio(&self) -> f64 {
        1.25
    }
}

#[cfg(test)]
mod tests;
