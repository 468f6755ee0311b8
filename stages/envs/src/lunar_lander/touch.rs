//! What touches the ground: the feet's flags, and whether the lander's body has crashed.
//!
//! As in the original a flag is not a state but the last event: a foot that leaves one edge of the ground while it still
//! stands on the next one counts as lifted.

use super::shape::{LANDER, LEG, SCALE, WIDTH};
use super::terrain::{POINTS, Terrain};
use super::world::Motion;
use crate::physics::convex::{self, Point32, SKIN};

/// Edges of the ground, and the line below it.
const EDGES: usize = POINTS;
/// Distance at which the original notices that a moving body arrives, between two looks: it stops bodies there.
const ARRIVED: f32 = 0.00625;
/// Corners of the largest body.
const MOST_CORNERS: usize = LANDER.len();

/// Who touches what.
#[derive(Clone, Debug)]
pub struct Touch {
    edges: [[Point32; 2]; EDGES],
    /// A bit per edge: the lander's body, then its legs.
    touching: [u16; 3],
    /// Flags of the legs.
    feet: [bool; 2],
    crashed: bool,
}

impl Touch {
    /// Nothing touches yet.
    pub fn new(terrain: &Terrain) -> Self {
        let mut edges = [[[0.0, 0.0], [WIDTH as f32, 0.0]]; EDGES];
        for (edge, points) in edges.iter_mut().zip(terrain.edges()) {
            *edge = points.map(|point| point.map(|v| v as f32));
        }
        Self { edges, touching: [0; 3], feet: [false; 2], crashed: false }
    }

    /// Flags of the legs.
    pub fn feet(&self) -> [bool; 2] {
        self.feet
    }

    /// True once the lander's body has touched anything.
    pub fn crashed(&self) -> bool {
        self.crashed
    }

    /// Looks at bodies that are about to move: what begins to touch, and what ends.
    pub fn look(&mut self, motions: &[Motion; 3]) {
        for (body, motion) in motions.iter().enumerate() {
            let now = self.edges_within(body, motion, SKIN);
            let before = std::mem::replace(&mut self.touching[body], now);
            if now & !before != 0 {
                self.begin(body);
            }
            if before & !now != 0 && body > 0 {
                self.feet[body - 1] = false;
            }
        }
    }

    /// Looks at bodies that have just moved: what has arrived.
    pub fn arrive(&mut self, motions: &[Motion; 3]) {
        for (body, motion) in motions.iter().enumerate() {
            let arrived = self.edges_within(body, motion, ARRIVED) & !self.touching[body];
            if arrived != 0 {
                self.touching[body] |= arrived;
                self.begin(body);
            }
        }
    }

    fn begin(&mut self, body: usize) {
        match body {
            0 => self.crashed = true,
            leg => self.feet[leg - 1] = true,
        }
    }

    /// The edges that are at most `distance` from a body.
    fn edges_within(&self, body: usize, motion: &Motion, distance: f32) -> u16 {
        let mut corners = [[0.0; 2]; MOST_CORNERS];
        let outline: &[[f64; 2]] = if body == 0 { &LANDER } else { &LEG };
        let corners = &mut corners[..outline.len()];
        for (to, corner) in corners.iter_mut().zip(outline) {
            *to = motion.point(corner.map(|v| (v / SCALE) as f32));
        }
        let mut box_ = [[f32::INFINITY; 2], [f32::NEG_INFINITY; 2]];
        for corner in corners.iter() {
            for axis in 0..2 {
                box_[0][axis] = box_[0][axis].min(corner[axis] - distance);
                box_[1][axis] = box_[1][axis].max(corner[axis] + distance);
            }
        }
        let mut found = 0;
        for (i, edge) in self.edges.iter().enumerate() {
            let apart = edge[1][0] < box_[0][0]
                || edge[0][0] > box_[1][0]
                || edge[0][1].max(edge[1][1]) < box_[0][1]
                || edge[0][1].min(edge[1][1]) > box_[1][1];
            if !apart && convex::closer_than(corners, edge, distance) {
                found |= 1 << i;
            }
        }
        found
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::lunar_lander::terrain::DRAWS;

    fn touch() -> Touch {
        Touch::new(&Terrain::new(&[3.0; DRAWS]))
    }

    /// Everything high up but the left leg's middle, which is here.
    fn leg_at(x: f32, y: f32) -> [Motion; 3] {
        let high = Motion { position: [5.0, 12.0], ..Motion::default() };
        [high, high, Motion { position: [x, y], ..Motion::default() }]
    }

    #[test]
    fn a_foot_within_the_skins_touches_and_stops_touching_when_lifted() {
        let foot = (8.0 / SCALE) as f32;
        let mut touch = touch();
        touch.arrive(&leg_at(9.0, 3.3 + foot + 0.015));
        assert_eq!(touch.feet(), [false, false], "not stopped yet");
        touch.look(&leg_at(9.0, 3.3 + foot + 0.015));
        assert_eq!(touch.feet(), [false, true]);
        touch.look(&leg_at(9.0, 3.3 + foot + 0.03));
        assert_eq!((touch.feet(), touch.crashed()), ([false, false], false));
        touch.arrive(&leg_at(9.0, 3.3 + foot + 0.005));
        assert_eq!(touch.feet(), [false, true]);
    }

    #[test]
    fn leaving_one_edge_counts_as_lifted_even_on_the_next_one() {
        let y = 3.3 + (8.0 / SCALE) as f32;
        let mut touch = touch();
        touch.look(&leg_at(10.0, y));
        touch.look(&leg_at(10.2, y));
        assert_eq!(touch.feet(), [false, false]);
    }

    #[test]
    fn the_body_crashes_for_good() {
        let mut touch = touch();
        let mut motions = leg_at(5.0, 12.0);
        motions[0].position = [10.0, 3.4];
        touch.look(&motions);
        motions[0].position = [10.0, 9.0];
        touch.look(&motions);
        assert!(touch.crashed());
    }
}
