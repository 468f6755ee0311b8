//! A simple pilot that steers by what he sees; the recordings' landings were flown by the same rules.

use super::simulation::OBSERVED;

/// What the pilot does now: main engine and sideways. All numbers are single precision, as in the original.
pub fn fly(observation: &[f64; OBSERVED]) -> [f64; 2] {
    let [x, y, vx, vy, angle, spin, right, left] = observation.map(|value| value as f32);
    let wanted_angle = (0.5 * x + vx).clamp(-0.4, 0.4);
    let wanted_height = 0.55 * x.abs();
    let mut turn = (wanted_angle - angle) * 0.5 - spin;
    let mut rise = (wanted_height - y) * 0.5 - vy * 0.5;
    if right > 0.0 || left > 0.0 {
        turn = 0.0;
        rise = -vy * 0.5;
    }
    [rise * 20.0 - 1.0, -turn * 20.0].map(|value| f64::from(value.clamp(-1.0, 1.0)))
}
