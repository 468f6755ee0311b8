//! The game without its image: lander, ground, reward and end of an episode.

use super::engines::{self, Push};
use super::shape::{DT, HEIGHT, WIDTH};
use super::start::Start;
use super::terrain::{DRAWS, PAD_HEIGHT, STANDING, Terrain};
use super::touch::Touch;
use super::world::{LanderWorld, Motion};
use crate::{Outcome, Step};

/// Values of an observation.
pub const OBSERVED: usize = 8;
/// What a step pays that crashes or leaves the world, and one that lands, instead of all else.
const ENDS: [f64; 2] = [-100.0, 100.0];
/// What full power of the main engine and of a side engine costs per step.
const FUEL: [f64; 2] = [0.30, 0.03];
/// Bodies slower than this (units per second; radians per second) come to rest: a hundredth, and two degrees.
const STILL: [f32; 2] = [0.01, 2.0 / 180.0 * std::f32::consts::PI];
/// The lander has landed when all bodies were still for so long, seconds.
const REST: f32 = 0.5;

/// The draws that an episode begins with.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Draws {
    /// Heights of the ground before smoothing, world units.
    pub heights: [f64; DRAWS],
    /// The push at the start.
    pub force: [f64; 2],
}

/// One episode.
pub struct Simulation {
    terrain: Terrain,
    world: LanderWorld,
    touch: Touch,
    pushes: [Push; 2],
    observation: [f64; OBSERVED],
    shaping: f64,
    still: [f32; 3],
    steps: usize,
    time_limit: usize,
    outcome: Outcome,
}

impl Simulation {
    /// The lander at the top of its world, after the original's reset: one step without a pilot has already passed.
    pub fn new(draws: &Draws, time_limit: usize) -> Self {
        let terrain = Terrain::new(&draws.heights);
        let mut simulation = Self {
            world: LanderWorld::new(&terrain, &Start::pushed(draws.force)),
            touch: Touch::new(&terrain),
            terrain,
            pushes: [Push::default(); 2],
            observation: [0.0; OBSERVED],
            shaping: 0.0,
            still: [0.0; 3],
            steps: 0,
            time_limit,
            outcome: Outcome::Running,
        };
        simulation.observe();
        simulation.shaping = simulation.potential();
        simulation
    }

    /// Flies one step. `action`: main engine and sideways, clamped to [-1, 1]; `dispersion`: two draws in [-1, 1).
    pub fn step(&mut self, action: [f64; 2], dispersion: [f64; 2]) -> Step {
        let lander = &self.world.motions()[0];
        let action = action.map(|v| v.clamp(-1.0, 1.0));
        let position = lander.position.map(f64::from);
        self.pushes = engines::fire(action, position, f64::from(lander.angle), dispersion);
        self.touch.look(self.world.motions());
        self.world.step(&self.pushes);
        self.touch.arrive(self.world.motions());
        self.rest();
        self.steps += 1;
        self.observe();
        let before = self.shaping;
        self.shaping = self.potential();
        let fuel: f64 = self.pushes.iter().zip(FUEL).map(|(push, cost)| push.power * cost).sum();
        let mut reward = self.shaping - before - fuel;
        self.outcome = self.verdict();
        match self.outcome {
            Outcome::Failed => reward = ENDS[0],
            Outcome::Finished => reward = ENDS[1],
            Outcome::Running | Outcome::TimeLimit => {}
        }
        Step { reward, outcome: self.outcome }
    }

    /// Counts for how long each body has been still.
    fn rest(&mut self) {
        for (still, motion) in self.still.iter_mut().zip(self.world.motions()) {
            let [vx, vy] = motion.velocity;
            let moves = vx * vx + vy * vy > STILL[0] * STILL[0] || motion.spin.abs() > STILL[1];
            *still = if moves { 0.0 } else { *still + DT as f32 };
        }
    }

    fn observe(&mut self) {
        let lander = &self.world.motions()[0];
        let [x, y] = lander.position.map(f64::from);
        let [vx, vy] = lander.velocity.map(f64::from);
        let half = [WIDTH / 2.0, HEIGHT / 2.0];
        let [right, left] = self.touch.feet().map(|touches| f64::from(u8::from(touches)));
        self.observation = [
            (x - half[0]) / half[0],
            (y - PAD_HEIGHT - STANDING) / half[1],
            vx * half[0] * DT,
            vy * half[1] * DT,
            f64::from(lander.angle),
            20.0 * f64::from(lander.spin) * DT,
            right,
            left,
        ];
    }

    /// How good the state is: rewards are its changes.
    fn potential(&self) -> f64 {
        let [x, y, vx, vy, angle, _, right, left] = self.observation;
        -100.0 * (x * x + y * y).sqrt() - 100.0 * (vx * vx + vy * vy).sqrt() - 100.0 * angle.abs()
            + 10.0 * right
            + 10.0 * left
    }

    fn verdict(&self) -> Outcome {
        let rested = self.still.iter().all(|still| *still >= REST);
        if rested {
            Outcome::Finished
        } else if self.touch.crashed() || self.observation[0].abs() >= 1.0 {
            Outcome::Failed
        } else if self.steps >= self.time_limit {
            Outcome::TimeLimit
        } else {
            Outcome::Running
        }
    }

    /// Position, velocity, angle, rotation (all scaled) and the flags of the right and the left foot.
    pub fn observation(&self) -> &[f64; OBSERVED] {
        &self.observation
    }

    /// How the episode stands.
    pub fn outcome(&self) -> Outcome {
        self.outcome
    }

    /// Steps flown.
    pub fn steps(&self) -> usize {
        self.steps
    }

    /// The ground.
    pub fn terrain(&self) -> &Terrain {
        &self.terrain
    }

    /// Lander and legs.
    pub fn motions(&self) -> &[Motion; 3] {
        self.world.motions()
    }

    /// What the engines did in the last step.
    pub fn pushes(&self) -> &[Push; 2] {
        &self.pushes
    }
}
