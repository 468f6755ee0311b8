//! Which tiles the wheels and the hull touch, which were visited, and which have lost their shade of grey.

use dril_stage_api::math;

use super::shape::{HULL, MOST_CORNERS, WHEEL_HALF};
use super::track::Track;
use super::tyre::SIZE;
use super::world::Motion;
use crate::physics::convex::{self, Point32};

/// Farthest part of the car from the hull's origin, world units, and some room for skins.
const CAR_REACH: f32 = 3.0;

/// The tiles of one episode. Nothing is allocated after [`Tiles::new`].
#[derive(Clone, Debug, Default)]
pub struct Tiles {
    centres: Vec<Point32>,
    reaches: Vec<f32>,
    corners: Vec<[Point32; 4]>,
    visited: Vec<bool>,
    faded: Vec<bool>,
    near: Vec<usize>,
    visits: usize,
}

/// What the wheels touch at one moment.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Contacts {
    /// Tiles under each wheel.
    pub under: [u8; 4],
    /// Tiles that a wheel reached for the first time.
    pub new_visits: usize,
    /// Which wheels touch tile 0, the start line.
    pub on_start: [bool; 4],
}

impl Tiles {
    /// The tiles of a track, none of them visited.
    pub fn new(track: &Track) -> Self {
        let n = track.tiles.len();
        let mut tiles = Self {
            near: Vec::with_capacity(n),
            visited: vec![false; n],
            faded: vec![false; n],
            ..Self::default()
        };
        for corners in &track.tiles {
            let corners = corners.map(|corner| corner.map(|v| v as f32));
            let centre = [0, 1].map(|axis| corners.iter().map(|c| c[axis]).sum::<f32>() / 4.0);
            let reach =
                corners.iter().map(|c| math::hypotf(c[0] - centre[0], c[1] - centre[1])).fold(0.0, f32::max);
            tiles.centres.push(centre);
            tiles.reaches.push(reach);
            tiles.corners.push(corners);
        }
        tiles
    }

    /// Number of tiles.
    pub fn len(&self) -> usize {
        self.corners.len()
    }

    /// True for a track without tiles.
    pub fn is_empty(&self) -> bool {
        self.corners.is_empty()
    }

    /// Tiles visited so far.
    pub fn visits(&self) -> usize {
        self.visits
    }

    /// Per tile: true once any part of the car has touched it, which resets its shade of grey.
    pub fn faded(&self) -> &[bool] {
        &self.faded
    }

    /// Looks at the car where it stands now, and books visits.
    pub fn touch(&mut self, hull: &Motion, wheels: &[Motion]) -> Contacts {
        self.find_near(hull);
        let mut contacts = Contacts::default();
        for (i, wheel) in wheels.iter().enumerate() {
            let outline = wheel_outline(wheel);
            for &tile in &self.near {
                if !convex::touches(&outline, &self.corners[tile]) {
                    continue;
                }
                contacts.under[i] += 1;
                contacts.on_start[i] |= tile == 0;
                self.faded[tile] = true;
                if !self.visited[tile] {
                    self.visited[tile] = true;
                    contacts.new_visits += 1;
                }
            }
        }
        self.visits += contacts.new_visits;
        self.fade_under_hull(hull);
        contacts
    }

    fn find_near(&mut self, hull: &Motion) {
        let [x, y] = hull.position.map(|v| v as f32);
        self.near.clear();
        for (tile, centre) in self.centres.iter().enumerate() {
            let [dx, dy] = [centre[0] - x, centre[1] - y];
            let reach = self.reaches[tile] + CAR_REACH;
            if dx * dx + dy * dy <= reach * reach {
                self.near.push(tile);
            }
        }
    }

    fn fade_under_hull(&mut self, hull: &Motion) {
        if self.near.iter().all(|tile| self.faded[*tile]) {
            return;
        }
        for part in HULL {
            let mut outline = [[0.0; 2]; MOST_CORNERS];
            for (to, corner) in outline.iter_mut().zip(part) {
                *to = hull.point(corner.map(|v| v * SIZE)).map(|v| v as f32);
            }
            for &tile in &self.near {
                if !self.faded[tile] && convex::touches(&outline[..part.len()], &self.corners[tile]) {
                    self.faded[tile] = true;
                }
            }
        }
    }
}

fn wheel_outline(wheel: &Motion) -> [Point32; 4] {
    let [w, h] = WHEEL_HALF.map(|half| half * SIZE);
    [[w, h], [-w, h], [-w, -h], [w, -h]].map(|corner| wheel.point(corner).map(|v| v as f32))
}
