//! A recorded run seen by the tile rules: poses come from the recording, contacts and visits from here.

use super::Run;
use super::pixels::motion;
use crate::car_racing::positions::{anchor, created};
use crate::car_racing::scene::Scene;
use crate::car_racing::tiles::{Contacts, Tiles};
use crate::car_racing::track::Track;
use crate::car_racing::tyre::DT;
use crate::car_racing::world::Motion;

/// A recorded run at some moment.
pub struct Watched<'a> {
    run: &'a Run,
    /// Its track.
    pub track: Track,
    tiles: Tiles,
    contacts: Contacts,
    moment: usize,
}

impl<'a> Watched<'a> {
    /// The run right after its reset.
    pub fn new(run: &'a Run, track: Track) -> Self {
        let mut tiles = Tiles::new(&track);
        let start = track.way_points[0];
        let at_rest = |pose: crate::car_racing::positions::Pose| {
            motion(&[f64::from(pose.x), f64::from(pose.y), f64::from(pose.angle)], &[0.0; 3])
        };
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
        let hull = motion(&row[..3], &row[3..6]);
        let wheel = |i: usize| {
            let [x, y] = hull.point(anchor(i).map(f64::from));
            motion(&[x, y, row[2] + row[6 + i]], &[0.0; 3])
        };
        (hull, std::array::from_fn(wheel))
    }
}
