//! LunarLanderContinuous: a lander with two engines over a random ground.
//!
//! Written from the facts of gym's LunarLanderContinuous-v2 (Klimov, 2016) and Gymnasium's v3, which play alike, with
//! rapier2d in place of Box2D. [`terrain`] makes the ground, [`engines`] the thrust, [`start`] the first moment; [`world`]
//! moves lander and legs, [`touch`] sees what touches the ground, [`simulation`] keeps the score, and [`render`] draws.

mod config;
pub mod engines;
pub mod pilot;
pub mod render;
pub mod shape;
pub mod simulation;
pub mod start;
pub mod terrain;
pub mod touch;
pub mod world;

use dril_stage_api::{Seed, StreamRng};
use rand::Rng;

use crate::episode::{EpisodeRunner, Game, Simulate};
use crate::settings::several;
use crate::{
    ActionSpace, Env, EnvError, EnvSettings, Frame, MapLine, ObservationSpace, Pose, RgbImage, Step,
};
pub use config::LunarLanderConfig;
use simulation::{Draws, OBSERVED, Simulation};
use terrain::MOST_HEIGHT;

/// The push at the start is at most this in each direction.
const MOST_FORCE: f64 = 1000.0;

/// LunarLanderContinuous: 8 numbers in, two actions out.
///
/// Action 0 is the main engine, off at and below 0 and from half to full power above; action 1 fires the engine that
/// pushes left below -0.5 and the one that pushes right above 0.5.
pub struct LunarLander {
    config: LunarLanderConfig,
    frame: [f32; OBSERVED],
    episode: Option<EpisodeRunner<Flight>>,
}

/// An episode: the simulation, and the random dispersion of its engines.
pub struct Flight {
    simulation: Simulation,
    dispersion: StreamRng,
}

impl LunarLander {
    /// An environment before its first episode.
    pub fn new(config: LunarLanderConfig) -> Self {
        Self { config, frame: [0.0; OBSERVED], episode: None }
    }

    /// What an episode with this seed begins with.
    pub fn draws(seed: u64) -> Draws {
        let (mut heights, mut force) =
            (Seed(seed).stream("lander/terrain"), Seed(seed).stream("lander/push"));
        Draws {
            heights: std::array::from_fn(|_| MOST_HEIGHT * unit_interval(&mut heights)),
            force: std::array::from_fn(|_| MOST_FORCE * (2.0 * unit_interval(&mut force) - 1.0)),
        }
    }

    /// The running episode.
    pub fn simulation(&self) -> Option<&Simulation> {
        self.episode.as_ref().map(|episode| &episode.simulation.simulation)
    }
}

impl Simulate for Flight {
    fn advance(&mut self, action: &[f32]) -> Step {
        let dispersion = std::array::from_fn(|_| 2.0 * unit_interval(&mut self.dispersion) - 1.0);
        self.simulation.step([0, 1].map(|value| f64::from(action[value])), dispersion)
    }
}

/// The top 53 bits of the next number, in [0, 1).
fn unit_interval(stream: &mut StreamRng) -> f64 {
    (stream.next_u64() >> 11) as f64 / (1u64 << 53) as f64
}

impl Game for LunarLander {
    type Simulation = Flight;
    const SPACES: (ObservationSpace, ActionSpace) =
        (ObservationSpace::Vector { len: OBSERVED }, ActionSpace::Continuous { dims: 2 });

    fn simulate(&self, seed: u64) -> Result<Flight, EnvError> {
        Ok(Flight {
            simulation: Simulation::new(&Self::draws(seed), self.time_limit()),
            dispersion: Seed(seed).stream("lander/dispersion"),
        })
    }

    fn time_limit(&self) -> usize {
        self.config.time_limit as usize
    }

    fn episode(&self) -> Option<&EpisodeRunner<Flight>> {
        self.episode.as_ref()
    }

    fn episode_mut(&mut self) -> &mut Option<EpisodeRunner<Flight>> {
        &mut self.episode
    }

    fn observe(&mut self) {
        self.frame = match &self.episode {
            Some(episode) => episode.simulation.simulation.observation().map(|value| value as f32),
            None => [0.0; OBSERVED],
        };
    }

    fn observation(&self) -> Frame<'_> {
        Frame::Vector(&self.frame)
    }

    fn draw(&self, flight: &Flight, width: usize, height: usize) -> RgbImage {
        render::draw(&flight.simulation, width, height)
    }

    fn pose_in(&self, flight: &Flight) -> Option<Pose> {
        let [lander, _, _] = flight.simulation.motions();
        let [position, velocity] = [lander.position, lander.velocity].map(|pair| pair.map(f64::from));
        Some(Pose::new(position, f64::from(lander.angle), velocity))
    }

    fn map_of(&self, flight: &Flight) -> Vec<MapLine> {
        vec![MapLine { name: "ground", points: flight.simulation.terrain().points.to_vec() }]
    }
}

impl EnvSettings for LunarLanderConfig {
    fn check(&self) -> Vec<(String, String)> {
        LunarLanderConfig::check(self)
    }

    fn build(&self, count: usize, _workers: usize) -> Result<Vec<Box<dyn Env>>, EnvError> {
        Ok(several(count, || LunarLander::new(self.clone())))
    }

    fn known_spaces(&self) -> Option<(ObservationSpace, ActionSpace)> {
        Some(LunarLander::SPACES)
    }

    fn action_labels(&self) -> &'static [&'static str] {
        &["main engine", "left | right"]
    }

    fn steps_per_second(&self) -> f64 {
        50.0
    }

    fn aspect_ratio(&self) -> f64 {
        1.5
    }
}

#[cfg(test)]
mod tests;
