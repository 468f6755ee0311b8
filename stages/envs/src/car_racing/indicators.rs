//! The black bar with its gauges: speed, wheel speeds, steering and yaw rate.

use dril_stage_api::math;

use super::camera::WINDOW;
use super::palette::{self, Colour, Inks};
use super::scene::Scene;
use crate::CarRacingVersion;
use crate::drawing::surface::Surface;

/// Window pixels of a gauge's unit: across and up.
const UNIT: [f64; 2] = [WINDOW[0] / 40.0, WINDOW[1] / 40.0];

/// What counts as 0 in the later version.
const AT_REST: f64 = 1e-4;

/// A filled box between two corners of the window (y up).
type Gauge = ([f64; 2], [f64; 2], Colour);

/// The gauges of a scene with the values they show, in drawing order.
fn gauges(scene: &Scene<'_>) -> [(f64, Gauge); 7] {
    let [vx, vy] = scene.hull.velocity;
    let upright = |place: f64, value: f64, scale: f64, colour| {
        let top = UNIT[1] * (1.0 + scale * value);
        (value, ([place * UNIT[0], UNIT[1]], [(place + 1.0) * UNIT[0], top], colour))
    };
    let lying = |place: f64, value: f64, scale: f64, colour| {
        let end = UNIT[0] * (place + scale * value);
        (value, ([place * UNIT[0], 2.0 * UNIT[1]], [end, 4.0 * UNIT[1]], colour))
    };
    [
        upright(5.0, math::hypot(vx, vy), 0.02, palette::WHITE),
        upright(7.0, scene.omegas[0], 0.01, palette::BLUE),
        upright(8.0, scene.omegas[1], 0.01, palette::BLUE),
        upright(9.0, scene.omegas[2], 0.01, palette::PURPLE),
        upright(10.0, scene.omegas[3], 0.01, palette::PURPLE),
        lying(20.0, scene.steering, -10.0, palette::GREEN),
        lying(30.0, scene.hull.spin, -0.8, palette::RED),
    ]
}

/// Draws bar and gauges; the later version leaves out a gauge at rest.
pub fn draw<S: Surface>(surface: &mut S, scene: &Scene<'_>, inks: &Inks, version: CarRacingVersion) {
    let scale = [0, 1].map(|axis| surface.size()[axis] as f64 / WINDOW[axis]);
    let dot = |[x, y]: [f64; 2]| [x * scale[0], (WINDOW[1] - y) * scale[1]];
    surface.fill_box(dot([0.0, 0.0]), dot([WINDOW[0], 5.0 * UNIT[1]]), inks.of(palette::BLACK));
    for (value, (from, to, colour)) in gauges(scene) {
        if version == CarRacingVersion::V3 && value.abs() <= AT_REST {
            continue;
        }
        surface.fill_box(dot(from), dot(to), inks.of(colour));
    }
}
