//! A recorded run played back through the tile rules: poses come from the recording, contacts and visits from ours.

use dril_envs::car_racing::positions::{Pose, anchor, created};
use dril_envs::car_racing::scene::Scene;
use dril_envs::car_racing::tiles::{Contacts, Tiles};
use dril_envs::car_racing::track::Track;
use dril_envs::car_racing::tyre::DT;
use dril_envs::car_racing::world::Motion;
use dril_stage_api::math;

use super::recording::Run;

/// A recorded run at some moment.
pub struct Playback<'a> {
    run: &'a Run,
    /// Its track.
    pub track: Track,
    tiles: Tiles,
    contacts: Contacts,
    moment: usize,
}

impl<'a> Playback<'a> {
    /// The run right after its reset.
    pub fn new(run: &'a Run, track: Track) -> Self {
        let mut tiles = Tiles::new(&track);
        let start = track.way_points[0];
        let at_rest =
            |pose: Pose| body(&[f64::from(pose.x), f64::from(pose.y), f64::from(pose.angle)], &[0.0; 3]);
        let [hull, wheels @ ..] = created(start.x, start.y, start.beta).map(at_rest);
        let contacts = tiles.touch(&hull, &wheels);
        Self { run, track, tiles, contacts, moment: 0 }
    }

    /// Goes on to a later moment, looking at every step on the way.
    pub fn go_to(&mut self, moment: usize) {
        while self.moment < moment {
            let (hull, wheels) = self.bodies();
            self.contacts = self.tiles.touch(&hull, &wheels);
            self.moment += 1;
        }
    }

    /// Tiles visited and touched so far.
    pub fn tiles(&self) -> (&Tiles, &Contacts) {
        (&self.tiles, &self.contacts)
    }

    /// What there is to draw.
    pub fn scene(&self) -> Scene<'_> {
        let row = self.run.states.row(self.moment);
        let four = |from: usize| [0, 1, 2, 3].map(|i| row[from + i]);
        let (hull, wheels) = self.bodies();
        Scene {
            hull,
            wheels,
            phases: four(14),
            omegas: four(10),
            steering: row[6],
            time: (self.moment + 1) as f64 * DT,
            score: self.run.rewards.values[..=self.moment].iter().sum(),
            faded: self.tiles.faded(),
        }
    }

    /// The hull, and the wheels on their joints.
    fn bodies(&self) -> (Motion, [Motion; 4]) {
        let row = self.run.states.row(self.moment);
        let hull = body(&row[..3], &row[3..6]);
        let wheel = |i: usize| {
            let [x, y] = hull.point(anchor(i).map(f64::from));
            body(&[x, y, row[2] + row[6 + i]], &[0.0; 3])
        };
        (hull, std::array::from_fn(wheel))
    }
}

/// The motion of a body, from (x, y, angle) and (vx, vy, spin).
pub(super) fn body(pose: &[f64], velocity: &[f64]) -> Motion {
    Motion {
        position: [pose[0], pose[1]],
        cos_sin: [math::cos(pose[2]), math::sin(pose[2])],
        velocity: [velocity[0], velocity[1]],
        spin: velocity[2],
    }
}
