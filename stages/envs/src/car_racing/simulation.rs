//! The game without its image: car, tiles, reward and end of an episode.

use super::car::{Car, Controls};
use super::positions;
use super::scene::Scene;
use super::tiles::{Contacts, Tiles};
use super::track::{PLAYFIELD, Track};
use super::tyre::DT;
use crate::{Outcome, Step};

/// Reward of all tiles together.
const LAP_REWARD: f64 = 1000.0;
/// What a step costs.
const STEP_COST: f64 = 0.1;
/// What a step pays that leaves the playfield, instead of all else.
const OFF_FIELD: f64 = -100.0;

/// When an episode ends.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Rules {
    /// Crossing the start line ends the lap once more than this part of the tiles is visited; 1: only all tiles do.
    pub lap_share: f64,
    /// Steps after which the episode is cut off.
    pub time_limit: usize,
}

/// One episode.
pub struct Simulation {
    track: Track,
    tiles: Tiles,
    car: Car,
    rules: Rules,
    contacts: Contacts,
    lap_closed: bool,
    score: f64,
    steps: usize,
    ticks: u32,
    outcome: Outcome,
}

impl Simulation {
    /// A car at the start of the track, after the original's reset: one step without a driver has already passed.
    pub fn new(track: Track, rules: Rules) -> Self {
        let start = track.way_points.first().map_or([0.0; 3], |p| [p.x, p.y, p.beta]);
        let tiles = Tiles::new(&track);
        let mut simulation = Self {
            tiles,
            track,
            car: Car::new(positions::created(start[0], start[1], start[2])),
            rules,
            contacts: Contacts::default(),
            lap_closed: false,
            score: 0.0,
            steps: 0,
            ticks: 1,
            outcome: Outcome::Running,
        };
        // The reset's step looks for contacts before it pulls the wheels into place.
        simulation.touch();
        simulation.car.world_mut().settle();
        simulation
    }

    /// Drives one step. Tiles are credited by where the car stood when the step began, as in the original.
    pub fn step(&mut self, controls: &Controls) -> Step {
        let before = self.score;
        let paid = self.pending_reward();
        self.car.control(controls);
        let on_road = self.contacts.under.map(|count| count > 0);
        self.touch();
        self.car.step(on_road);
        self.ticks += 1;
        self.steps += 1;
        self.score -= STEP_COST;
        let mut reward = self.score - before + paid;
        self.outcome = self.verdict();
        if self.outcome == Outcome::Failed {
            reward = OFF_FIELD;
        }
        Step { reward, outcome: self.outcome }
    }

    /// What the reset's step earned is paid with the first step.
    fn pending_reward(&self) -> f64 {
        if self.steps == 0 { self.score } else { 0.0 }
    }

    fn touch(&mut self) {
        let was_on_start = self.contacts.on_start;
        self.contacts = self.tiles.touch(self.car.world().hull(), self.car.world().wheels());
        let n = self.tiles.len() as f64;
        for _ in 0..self.contacts.new_visits {
            self.score += LAP_REWARD / n;
        }
        let begins = (0..4).any(|wheel| self.contacts.on_start[wheel] && !was_on_start[wheel]);
        self.lap_closed |= begins && self.tiles.visits() as f64 / n > self.rules.lap_share;
    }

    fn verdict(&self) -> Outcome {
        let [x, y] = self.car.hull().position;
        if x.abs() > PLAYFIELD || y.abs() > PLAYFIELD {
            Outcome::Failed
        } else if self.lap_closed || self.tiles.visits() == self.tiles.len() {
            Outcome::Finished
        } else if self.steps >= self.rules.time_limit {
            Outcome::TimeLimit
        } else {
            Outcome::Running
        }
    }

    /// How the episode stands.
    pub fn outcome(&self) -> Outcome {
        self.outcome
    }

    /// Steps driven.
    pub fn steps(&self) -> usize {
        self.steps
    }

    /// The track.
    pub fn track(&self) -> &Track {
        &self.track
    }

    /// Tiles and visits.
    pub fn tiles(&self) -> &Tiles {
        &self.tiles
    }

    /// What the wheels touched when last looked at.
    pub fn contacts(&self) -> &Contacts {
        &self.contacts
    }

    /// The car.
    pub fn car(&self) -> &Car {
        &self.car
    }

    /// The car, to place it elsewhere.
    pub fn car_mut(&mut self) -> &mut Car {
        &mut self.car
    }

    /// What there is to draw.
    pub fn scene(&self) -> Scene<'_> {
        let world = self.car.world();
        // The original draws before it books the step's cost.
        let score = if self.steps == 0 { self.score } else { self.score + STEP_COST };
        Scene {
            hull: *world.hull(),
            wheels: std::array::from_fn(|i| world.wheels()[i]),
            phases: self.car.tyres.map(|tyre| tyre.phase),
            omegas: self.car.tyres.map(|tyre| tyre.omega),
            steering: world.joint_angle(0),
            time: f64::from(self.ticks) * DT,
            score,
            faded: self.tiles.faded(),
        }
    }
}
