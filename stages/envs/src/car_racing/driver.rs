//! A simple driver that looks at the track ahead; the recordings' closed-loop laps were driven by the same rules.

use std::f64::consts::{PI, TAU};

use dril_stage_api::math;

use crate::car_racing::car::Controls;
use crate::car_racing::simulation::Simulation;
use crate::car_racing::track::WayPoint;

/// What the driver does now.
pub fn drive(simulation: &Simulation) -> Controls {
    let (hull, points) = (simulation.car().hull(), &simulation.track().way_points);
    let nearest = nearest(points, hull.position);
    let speed = math::hypot(hull.velocity[0], hull.velocity[1]);
    let at = |ahead: usize| &points[(nearest + ahead) % points.len()];
    let target = at((3.0 + 0.04 * speed) as usize);
    let [dx, dy] = [target.x - hull.position[0], target.y - hull.position[1]];
    let [cos, sin] = hull.cos_sin;
    let error = math::atan2(cos * dx + sin * dy, -sin * dx + cos * dy);
    let turn = |k: usize| wrapped(at(4 * (k + 1)).beta - at(4 * k).beta).abs();
    let sharpest = (0..3).map(turn).fold(0.0, f64::max);
    let wanted = 70.0 / (1.0 + 0.5 * sharpest);
    let pedal = |value: f64, most: f64| f64::from(value.clamp(0.0, most) as f32);
    Controls {
        steer: f64::from((2.0 * error).clamp(-1.0, 1.0) as f32),
        gas: pedal(0.1 * (wanted - speed), 0.5),
        brake: pedal(0.05 * (speed - wanted), 0.6),
    }
}

fn nearest(points: &[WayPoint], [x, y]: [f64; 2]) -> usize {
    let distance = |point: &WayPoint| {
        let [dx, dy] = [point.x - x, point.y - y];
        dx * dx + dy * dy
    };
    let closer = |best: (usize, f64), (i, point): (usize, &WayPoint)| {
        let d = distance(point);
        if d < best.1 { (i, d) } else { best }
    };
    points.iter().enumerate().fold((0, f64::INFINITY), closer).0
}

/// An angle in [-pi, pi).
fn wrapped(angle: f64) -> f64 {
    (angle + PI).rem_euclid(TAU) - PI
}
