//! LunarLanderContinuous: a lander with two engines over a random ground.
//!
//! Written from the facts of gym's LunarLanderContinuous-v2 (Klimov, 2016) and Gymnasium's v3, which play alike, with
//! rapier2d in place of Box2D. [`terrain`] makes the ground, [`engines`] the thrust, [`start`] the first moment; [`world`]
//! moves lander and legs, [`touch`] sees what touches the ground, [`simulation`] keeps the score, and [`picture`] draws.

pub mod engines;
pub mod picture;
pub mod shape;
pub mod simulation;
pub mod start;
pub mod terrain;
pub mod touch;
pub mod world;

use dril_stage_api::{Seed, StreamRng};
use rand::Rng;

use crate::played::{Game, Played};
use crate::{
    ActionSpace, Env, EnvError, EnvSnapshot, Frame, LunarLanderConfig, MapLine, ObservationSpace, Picture,
    Step,
};
use simulation::{Draws, OBSERVED, Simulation};
use terrain::MOST_HEIGHT;

/// Values of an action: main engine and side engines.
const DIMS: usize = 2;
/// The push at the start is at most this in each direction.
const MOST_FORCE: f64 = 1000.0;

/// LunarLanderContinuous: 8 numbers in, two actions out.
///
/// Action 0 is the main engine, off at and below 0 and from half to full power above; action 1 fires the engine that
/// pushes left below -0.5 and the one that pushes right above 0.5.
pub struct LunarLander {
    config: LunarLanderConfig,
    frame: [f32; OBSERVED],
    episode: Option<Played<Flight>>,
}

struct Flight {
    simulation: Simulation,
    dispersion: StreamRng,
}

impl LunarLander {
    /// What it shows and takes.
    pub const SPACES: (ObservationSpace, ActionSpace) =
        (ObservationSpace::Vector { len: OBSERVED }, ActionSpace::Continuous { dims: DIMS });

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
        self.episode.as_ref().map(|episode| &episode.game.simulation)
    }

    fn start(&mut self, seed: u64) {
        let limit = self.config.time_limit as usize;
        let game = Flight {
            simulation: Simulation::new(&Self::draws(seed), limit),
            dispersion: Seed(seed).stream("lander/dispersion"),
        };
        self.episode = Some(Played::begin(seed, game, limit.saturating_mul(DIMS), self.episode.take()));
    }

    fn observe(&mut self) {
        if let Some(episode) = &self.episode {
            self.frame = episode.game.simulation.observation().map(|value| value as f32);
        }
    }
}

impl Game<DIMS> for Flight {
    fn play(&mut self, action: [f32; DIMS]) -> Step {
        let dispersion = std::array::from_fn(|_| 2.0 * unit_interval(&mut self.dispersion) - 1.0);
        self.simulation.step(action.map(f64::from), dispersion)
    }
}

/// The top 53 bits of the next number, in [0, 1).
fn unit_interval(stream: &mut StreamRng) -> f64 {
    (stream.next_u64() >> 11) as f64 / (1u64 << 53) as f64
}

impl Env for LunarLander {
    fn observation_space(&self) -> ObservationSpace {
        Self::SPACES.0
    }

    fn action_space(&self) -> ActionSpace {
        Self::SPACES.1
    }

    fn reset(&mut self, seed: u64) -> Result<(), EnvError> {
        self.start(seed);
        self.observe();
        Ok(())
    }

    fn step(&mut self, action: &[f32]) -> Result<Step, EnvError> {
        let step = self.episode.as_mut().ok_or(EnvError::NotStarted)?.step(action)?;
        self.observe();
        Ok(step)
    }

    fn frame(&self) -> Frame<'_> {
        Frame::Vector(&self.frame)
    }

    fn snapshot(&self) -> EnvSnapshot {
        Played::snapshot(self.episode.as_ref())
    }

    fn restore(&mut self, snapshot: &EnvSnapshot) -> Result<(), EnvError> {
        let Some(seed) = snapshot.seed else {
            self.episode = None;
            self.frame.fill(0.0);
            return Ok(());
        };
        self.start(seed);
        if let Some(episode) = self.episode.as_mut() {
            snapshot.replay(DIMS, |action| episode.step(action))?;
        }
        self.observe();
        Ok(())
    }

    fn render(&mut self, width: usize, height: usize) -> Result<Picture, EnvError> {
        let episode = self.episode.as_ref().ok_or(EnvError::NotStarted)?;
        picture::draw(&episode.game.simulation, width, height)
    }

    fn pose(&self) -> Option<crate::Pose> {
        let [lander, _, _] = self.simulation()?.motions();
        let [position, velocity] = [lander.position, lander.velocity].map(|pair| pair.map(f64::from));
        Some(crate::Pose::new(position, f64::from(lander.angle), velocity))
    }

    fn map(&self) -> Vec<MapLine> {
        let ground = |simulation: &Simulation| MapLine {
            name: "ground",
            points: simulation.terrain().points.to_vec(),
        };
        self.simulation().map(ground).into_iter().collect()
    }
}

#[cfg(test)]
mod tests;
