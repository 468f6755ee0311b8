//! The black bar with its gauges: speed, wheel speeds, steering and yaw rate.

use super::camera::WINDOW;
use super::palette::{self, Colour, Inks};
use super::raster::Canvas;
use super::scene::Scene;

/// Window pixels of a gauge's unit: across and up.
const UNIT: [f64; 2] = [WINDOW[0] / 40.0, WINDOW[1] / 40.0];

/// A filled box between two corners of the window (y up).
pub type Gauge = ([f64; 2], [f64; 2], Colour);

/// The gauges of a scene, in drawing order.
pub fn gauges(scene: &Scene<'_>) -> [Gauge; 7] {
    let [vx, vy] = scene.hull.velocity;
    let upright = |place: f64, length: f64, colour| {
        ([place * UNIT[0], UNIT[1]], [(place + 1.0) * UNIT[0], UNIT[1] + length * UNIT[1]], colour)
    };
    let lying = |place: f64, length: f64, colour| {
        ([place * UNIT[0], 2.0 * UNIT[1]], [(place + length) * UNIT[0], 4.0 * UNIT[1]], colour)
    };
    [
        upright(5.0, 0.02 * vx.hypot(vy), palette::WHITE),
        upright(7.0, 0.01 * scene.omegas[0], palette::BLUE),
        upright(8.0, 0.01 * scene.omegas[1], palette::BLUE),
        upright(9.0, 0.01 * scene.omegas[2], palette::PURPLE),
        upright(10.0, 0.01 * scene.omegas[3], palette::PURPLE),
        lying(20.0, -10.0 * scene.steering, palette::GREEN),
        lying(30.0, -0.8 * scene.hull.spin, palette::RED),
    ]
}

/// Draws bar and gauges.
pub fn draw(canvas: &mut Canvas, scene: &Scene<'_>, inks: &Inks) {
    let scale = [canvas.width() as f64 / WINDOW[0], canvas.height() as f64 / WINDOW[1]];
    let dot = |[x, y]: [f64; 2]| [x * scale[0], (WINDOW[1] - y) * scale[1]];
    canvas.fill_box(dot([0.0, 0.0]), dot([WINDOW[0], 5.0 * UNIT[1]]), inks.of(palette::BLACK));
    for (from, to, colour) in gauges(scene) {
        canvas.fill_box(dot(from), dot(to), inks.of(colour));
    }
}
