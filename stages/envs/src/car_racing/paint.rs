//! Paints road, kerbs and car on a surface, in the order of the original.

use dril_stage_api::math;

use super::camera::Camera;
use super::palette::{self, Colour, Inks};
use super::scene::Scene;
use super::shape::{HULL, MOST_CORNERS, WHEEL_HALF};
use super::track::{Kerb, Track};
use super::tyre::SIZE;
use super::world::Motion;
use crate::drawing::surface::Surface;

/// Farthest that tile and kerb reach from the tile's way point, world units.
const TILE_REACH: f64 = 10.0;
/// Length of the mark on a turning wheel, radians.
const MARK: f64 = 1.2;

/// A surface with what it takes to paint on it.
pub struct Painter<'a, S> {
    /// What is painted on.
    pub surface: &'a mut S,
    /// From the world to the surface.
    pub camera: Camera,
    /// What is written for each colour.
    pub inks: &'a Inks,
    /// First line of the bar, which hides the world.
    pub floor: usize,
}

impl<S: Surface> Painter<'_, S> {
    /// Tiles and kerbs along the track, of which later ones hide earlier ones.
    pub fn road(&mut self, track: &Track, scene: &Scene<'_>) {
        self.surface.begin_mosaic();
        let mut kerbs = track.kerbs.iter().peekable();
        let mut reversed_kerbs = track.kerbs.iter().rev().peekable();
        let n = track.tiles.len().min(track.way_points.len());
        for at in 0..n {
            let i = if S::MOSAIC_FROM_FRONT { n - 1 - at } else { at };
            let [kerb_before, kerb_after] = if S::MOSAIC_FROM_FRONT {
                [reversed_kerbs.next_if(|kerb| kerb.tile == i), None]
            } else {
                [None, kerbs.next_if(|kerb| kerb.tile == i)]
            };
            let place = &track.way_points[i];
            if !self.camera.may_see([place.x, place.y], TILE_REACH) {
                continue;
            }
            self.kerb(kerb_before);
            let shade = if scene.faded.get(i).copied().unwrap_or(false) { 0 } else { i % 3 };
            self.fill(&track.tiles[i].map(|p| self.camera.dot(p)), palette::ROAD[shade]);
            self.kerb(kerb_after);
        }
        self.surface.end_mosaic(self.floor);
    }

    fn kerb(&mut self, kerb: Option<&Kerb>) {
        if let Some(kerb) = kerb {
            let colour = if kerb.white { palette::WHITE } else { palette::KERB_RED };
            self.fill(&kerb.corners.map(|p| self.camera.dot(p)), colour);
        }
    }

    /// Wheels with their marks, then the hull.
    pub fn car(&mut self, scene: &Scene<'_>) {
        let [w, h] = WHEEL_HALF;
        for (wheel, phase) in scene.wheels.iter().zip(scene.phases) {
            self.part(wheel, &[[-w, h], [w, h], [w, -h], [-w, -h]], palette::BLACK);
            if let Some([from, to]) = wheel_mark(phase) {
                self.part(wheel, &[[-w, from], [w, from], [w, to], [-w, to]], palette::WHEEL_MARK);
            }
        }
        for outline in HULL {
            self.part(&scene.hull, outline, palette::HULL);
        }
    }

    /// A part of the car, given in units of [`SIZE`] in the frame of its body.
    fn part(&mut self, body: &Motion, outline: &[[f64; 2]], colour: Colour) {
        let mut dots = [[0.0; 2]; MOST_CORNERS];
        for (dot, corner) in dots.iter_mut().zip(outline) {
            *dot = self.camera.dot(body.point(corner.map(|v| v * SIZE)));
        }
        self.fill(&dots[..outline.len()], colour);
    }

    /// Fills a polygon of the surface.
    pub(super) fn fill(&mut self, dots: &[[f64; 2]], colour: Colour) {
        self.surface.fill(dots, self.inks.of(colour), self.floor);
    }
}

/// From where to where along a wheel its mark is seen, in units of [`SIZE`]; none while it is underneath.
fn wheel_mark(phase: f64) -> Option<[f64; 2]> {
    let ends = [phase, phase + MARK].map(math::sin_cos);
    if ends.iter().all(|(sin, _)| *sin > 0.0) {
        return None;
    }
    // The end that is underneath shows at the wheel's edge.
    let seen = |(sin, cos): (f64, f64)| if sin > 0.0 { cos.signum() } else { cos };
    Some(ends.map(|end| seen(end) * WHEEL_HALF[1]))
}
