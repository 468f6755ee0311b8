//! The picture of gym's CarRacing-v0: plain polygons, one sample per pixel, the camera follows the velocity.

use super::camera::Camera;
use super::palette::{self, Colour, Inks};
use super::raster::Canvas;
use super::scene::Scene;
use super::shape::{HULL, MOST_CORNERS, WHEEL_HALF};
use super::text::Text;
use super::track::Track;
use super::tyre::SIZE;
use super::world::Motion;
use super::{grass, indicators};

/// Height of the bar at the bottom, as a part of the picture's height.
const BAR: f64 = 1.0 / 8.0;
/// Farthest that tile and kerb reach from the tile's way point, world units.
const TILE_REACH: f64 = 10.0;
/// Length of the mark on a turning wheel, radians.
const MARK: f64 = 1.2;

/// A picture and how to draw it.
#[derive(Clone, Debug)]
pub struct Renderer {
    canvas: Canvas,
    inks: Inks,
    text: Text,
}

impl Renderer {
    /// Pictures of this size in these inks.
    pub fn new(width: usize, height: usize, inks: Inks) -> Self {
        Self { canvas: Canvas::new(width, height), inks, text: Text::new(width, height) }
    }

    /// The last picture drawn, row-major.
    pub fn pixels(&self) -> &[u8] {
        self.canvas.pixels()
    }

    /// Draws the scene.
    pub fn draw(&mut self, track: &Track, scene: &Scene<'_>) {
        let size = [self.canvas.width(), self.canvas.height()];
        let camera = Camera::following_velocity(scene, size);
        let floor = size[1] - (size[1] as f64 * BAR) as usize;
        grass::draw(&mut self.canvas, &camera, &self.inks, floor);
        self.draw_road(track, scene, &camera, floor);
        self.draw_car(scene, &camera, floor);
        indicators::draw(&mut self.canvas, scene, &self.inks);
        self.text.draw(&mut self.canvas, scene.score, &self.inks);
    }

    fn draw_road(&mut self, track: &Track, scene: &Scene<'_>, camera: &Camera, floor: usize) {
        let mut kerbs = track.kerbs.iter().peekable();
        for (i, (tile, at)) in track.tiles.iter().zip(&track.way_points).enumerate() {
            let kerb = kerbs.next_if(|kerb| kerb.tile == i);
            if !camera.may_see([at.x, at.y], TILE_REACH) {
                continue;
            }
            let shade = if scene.faded.get(i).copied().unwrap_or(false) { 0 } else { i % 3 };
            self.fill(&tile.map(|p| camera.dot(p)), palette::ROAD[shade], floor);
            if let Some(kerb) = kerb {
                let colour = if kerb.white { palette::WHITE } else { palette::KERB_RED };
                self.fill(&kerb.corners.map(|p| camera.dot(p)), colour, floor);
            }
        }
    }

    fn draw_car(&mut self, scene: &Scene<'_>, camera: &Camera, floor: usize) {
        let [w, h] = WHEEL_HALF;
        for (wheel, phase) in scene.wheels.iter().zip(scene.phases) {
            self.part(camera, wheel, &[[-w, h], [w, h], [w, -h], [-w, -h]], palette::BLACK, floor);
            if let Some([from, to]) = wheel_mark(phase) {
                let mark = [[-w, from], [w, from], [w, to], [-w, to]];
                self.part(camera, wheel, &mark, palette::WHEEL_MARK, floor);
            }
        }
        for outline in HULL {
            self.part(camera, &scene.hull, outline, palette::HULL, floor);
        }
    }

    /// Fills a part of the car, given in units of [`SIZE`] in the frame of its body.
    fn part(&mut self, camera: &Camera, body: &Motion, outline: &[[f64; 2]], colour: Colour, floor: usize) {
        let mut dots = [[0.0; 2]; MOST_CORNERS];
        for (dot, corner) in dots.iter_mut().zip(outline) {
            *dot = camera.dot(body.point(corner.map(|v| v * SIZE)));
        }
        self.fill(&dots[..outline.len()], colour, floor);
    }

    fn fill(&mut self, dots: &[[f64; 2]], colour: Colour, floor: usize) {
        self.canvas.fill(dots, self.inks.of(colour), floor);
    }
}

/// From where to where along a wheel its mark is seen, in units of [`SIZE`]; none while it is underneath.
pub fn wheel_mark(phase: f64) -> Option<[f64; 2]> {
    let ends = [phase, phase + MARK].map(f64::sin_cos);
    if ends.iter().all(|(sin, _)| *sin > 0.0) {
        return None;
    }
    // The end that is underneath shows at the wheel's edge.
    let seen = |(sin, cos): (f64, f64)| if sin > 0.0 { cos.signum() } else { cos };
    Some(ends.map(|end| seen(end) * WHEEL_HALF[1]))
}
