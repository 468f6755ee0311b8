//! The camera: from the world to the original's window of 1000 x 800 and on to the image.

use dril_stage_api::math;

use super::scene::Scene;
use crate::drawing::surface::Point;

/// The original's window, in its pixels; its y runs up.
pub const WINDOW: [f64; 2] = [1000.0, 800.0];
/// Where the car is in the window.
const CAR_AT: [f64; 2] = [WINDOW[0] / 2.0, WINDOW[1] / 4.0];
/// Window pixels per world unit, at the start of an episode and after its first second.
const ZOOM: [f64; 2] = [0.1 * 6.0, 2.7 * 6.0];
/// Below this speed the view of the original follows the hull, units per second.
const STANDING: f64 = 0.5;

/// An affine map from world to image.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Camera {
    /// World units to image pixels.
    matrix: [[f64; 2]; 2],
    origin: [f64; 2],
    car: [f64; 2],
    /// World point in the middle of the window, and the distance from it to the window's corners.
    middle: ([f64; 2], f64),
}

impl Camera {
    /// The view of the original: it turns with the velocity, so that a sliding car is seen from the side.
    pub fn following_velocity(scene: &Scene, size: [usize; 2]) -> Self {
        let [vx, vy] = scene.hull.velocity;
        let speed = math::hypot(vx, vy);
        if speed > STANDING {
            Self::new(scene, [vx / speed, vy / speed], size)
        } else {
            Self::following_hull(scene, size)
        }
    }

    /// The view of the later version: the hull always points up.
    pub fn following_hull(scene: &Scene, size: [usize; 2]) -> Self {
        let [cos, sin] = scene.hull.cos_sin;
        Self::new(scene, [-sin, cos], size)
    }

    /// `up`: the direction in the world that points up in the window, of length 1.
    fn new(scene: &Scene, up: [f64; 2], size: [usize; 2]) -> Self {
        let zoom = ZOOM[0] * (1.0 - scene.time).max(0.0) + ZOOM[1] * scene.time.min(1.0);
        let scale = [0, 1].map(|axis| size[axis] as f64 / WINDOW[axis]);
        let (right, car) = ([up[1], -up[0]], scene.hull.position);
        let above = (WINDOW[1] / 2.0 - CAR_AT[1]) / zoom;
        let middle = [car[0] + up[0] * above, car[1] + up[1] * above];
        Self {
            matrix: [right.map(|v| v * zoom * scale[0]), up.map(|v| -v * zoom * scale[1])],
            origin: [CAR_AT[0] * scale[0], (WINDOW[1] - CAR_AT[1]) * scale[1]],
            car,
            middle: (middle, math::hypot(WINDOW[0], WINDOW[1]) / 2.0 / zoom),
        }
    }

    /// The image's point for a point of the world.
    pub fn dot(&self, [x, y]: [f64; 2]) -> Point {
        let [dx, dy] = [x - self.car[0], y - self.car[1]];
        let along = |axis: usize| self.matrix[axis][0] * dx + self.matrix[axis][1] * dy + self.origin[axis];
        [along(0), along(1)]
    }

    /// The world's point in the middle of the window, and the distance from it to the window's corners.
    pub fn view(&self) -> ([f64; 2], f64) {
        self.middle
    }

    /// False only where nothing within `reach` of the point can be in the window.
    pub fn may_see(&self, [x, y]: [f64; 2], reach: f64) -> bool {
        let ([mx, my], radius) = self.middle;
        let (dx, dy, most) = (x - mx, y - my, radius + reach);
        dx * dx + dy * dy <= most * most
    }
}
