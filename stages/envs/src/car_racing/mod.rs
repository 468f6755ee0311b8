//! CarRacing: a car on a random track, seen from above.
//!
//! Written from the facts of gym's CarRacing-v0 (Klimov, 2016) and Gymnasium's CarRacing-v3, with rapier2d in place of
//! Box2D. [`track`] makes the track, [`car`], [`tyre`] and [`world`] move the car, [`tiles`] sees what it touches,
//! [`simulation`] keeps the score, and [`render`] draws a [`scene`].

pub mod camera;
pub mod car;
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

use crate::played::{Game, Played};
use crate::preprocess::{self, FULL, SIDE};
use crate::{
    ActionSpace, CarRacingConfig, Env, EnvError, EnvSnapshot, Frame, MapLine, ObservationSpace, Picture, Step,
};
use car::Controls;
use render::{Output, Renderer};
use simulation::{Rules, Simulation};
use track::{DRAWS, Track};

/// Values of an action: steering, and throttle or brake.
const DIMS: usize = 2;
/// Attempts after which the track draws cannot be uniform: one in ten fails.
const MOST_ATTEMPTS: usize = 1000;

/// CarRacing as the thesis's policies see it: 84 x 84 grey, two actions.
///
/// Action 0 steers, -1 (left) to 1 (right); action 1 is the throttle above 0 and the brake below.
pub struct CarRacing {
    config: CarRacingConfig,
    renderer: Renderer,
    frame: Box<[u8; SIDE * SIDE]>,
    episode: Option<Played<Simulation>>,
}

impl CarRacing {
    /// What it shows and takes.
    pub const SPACES: (ObservationSpace, ActionSpace) = (
        ObservationSpace::Image { height: SIDE, width: SIDE, stack: 4 },
        ActionSpace::Continuous { dims: DIMS },
    );

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
        self.episode.as_ref().map(|episode| &episode.game)
    }

    fn start(&mut self, seed: u64) -> Result<(), EnvError> {
        let (track, _) = Self::track(seed)?;
        let limit = self.config.time_limit as usize;
        let rules = Rules { lap_share: self.config.lap_share(), time_limit: limit };
        let before = self.episode.take();
        let game = Simulation::new(track, rules);
        self.episode = Some(Played::begin(seed, game, limit.saturating_mul(DIMS), before));
        Ok(())
    }

    fn draw(&mut self) {
        if let Some(episode) = &self.episode {
            self.renderer.draw(episode.game.track(), &episode.game.scene());
            if let Ok(full) = self.renderer.pixels().try_into() {
                preprocess::shrink(full, &mut self.frame);
            }
        }
    }
}

impl Game<DIMS> for Simulation {
    fn play(&mut self, action: [f32; DIMS]) -> Step {
        let [steer, pedal] = action.map(f64::from);
        self.step(&Controls { steer, gas: pedal.max(0.0), brake: (-pedal).max(0.0) })
    }
}

/// The top 53 bits as a number in [0, 1).
fn unit_interval(bits: u64) -> f64 {
    (bits >> 11) as f64 / (1u64 << 53) as f64
}

impl Env for CarRacing {
    fn observation_space(&self) -> ObservationSpace {
        Self::SPACES.0
    }

    fn action_space(&self) -> ActionSpace {
        Self::SPACES.1
    }

    fn reset(&mut self, seed: u64) -> Result<(), EnvError> {
        self.start(seed)?;
        self.draw();
        Ok(())
    }

    fn step(&mut self, action: &[f32]) -> Result<Step, EnvError> {
        let step = self.episode.as_mut().ok_or(EnvError::NotStarted)?.step(action)?;
        self.draw();
        Ok(step)
    }

    fn frame(&self) -> Frame<'_> {
        Frame::Image(self.frame.as_slice())
    }

    fn snapshot(&self) -> EnvSnapshot {
        Played::snapshot(self.episode.as_ref())
    }

    fn restore(&mut self, snapshot: &EnvSnapshot) -> Result<(), EnvError> {
        let Some(seed) = snapshot.seed else {
            self.episode = None;
            self.frame.fill(0);
            return Ok(());
        };
        self.start(seed)?;
        if let Some(episode) = self.episode.as_mut() {
            snapshot.replay(DIMS, |action| episode.step(action))?;
        }
        self.draw();
        Ok(())
    }

    fn render(&mut self, width: usize, height: usize) -> Result<Picture, EnvError> {
        let episode = self.episode.as_ref().ok_or(EnvError::NotStarted)?;
        Picture::check_size(width, height)?;
        let size = [width, height];
        let mut renderer = Renderer::averaged(self.config.version, Output::Rgb, size);
        renderer.draw(episode.game.track(), &episode.game.scene());
        Ok(Picture { width, height, rgb: renderer.pixels().to_vec() })
    }

    fn pose(&self) -> Option<crate::Pose> {
        let car = self.simulation()?.car();
        let hull = car.hull();
        Some(crate::Pose::new(hull.position, car.world().hull_angle(), hull.velocity))
    }

    fn map(&self) -> Vec<MapLine> {
        let Some(simulation) = self.simulation() else { return Vec::new() };
        let side = |name, corner: usize| {
            let tiles = &simulation.track().tiles;
            MapLine { name, points: tiles.iter().chain(tiles.first()).map(|tile| tile[corner]).collect() }
        };
        vec![side("left", 0), side("right", 1)]
    }
}

#[cfg(test)]
mod tests;
