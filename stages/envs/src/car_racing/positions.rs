//! Integration of positions from velocities, as in Box2D.
//!
//! The engine here solves the velocities of bodies and joints well, but turns bodies by a first-order step, which loses
//! a thousandth of every turn, limits speeds elsewhere and pulls joints together differently. The original moves each
//! body by its velocity, caps the distance, and then pulls the joints together by moving positions only, one joint after
//! the other. Its reset leans on that, too: it creates the wheels beside an unrotated hull and lets this solver pull
//! them into place.

use dril_stage_api::math;

use super::shape::{self, WHEELS};
use super::tyre::{DT, SIZE};

/// Most sweeps over the joints per step.
const SWEEPS: usize = 60;
/// Gap that is left as it is, world units.
const SLOP: f32 = 0.005;
/// Maximum distance that a body moves in one step, world units.
const MAX_TRANSLATION: f32 = 2.0;
/// Steering stops at this angle, radians.
pub const STEER_LIMIT: f32 = 0.4;
/// A joint may overshoot its stop by this much before it is turned back: two degrees.
const STEER_SLACK: f32 = 2.0 / 180.0 * std::f32::consts::PI;
/// Most that a joint is turned back in one sweep: eight degrees.
const STEER_CORRECTION: f32 = 4.0 * STEER_SLACK;

/// Position of a body's origin, and its angle.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Pose {
    /// World units.
    pub x: f32,
    /// World units.
    pub y: f32,
    /// Radians, not wrapped; forward is (-sin, cos).
    pub angle: f32,
}

/// Velocity of a body's centre of mass, and its rotation.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Velocity {
    /// Units per second.
    pub linear: [f32; 2],
    /// Radians per second.
    pub spin: f32,
}

/// Bodies by number: the hull, then the wheels front left, front right, rear left, rear right.
pub const BODIES: usize = 5;

/// The car as the original creates it: hull turned to `beta`, wheels turned but not moved with it.
pub fn created(x: f64, y: f64, beta: f64) -> [Pose; BODIES] {
    let hull = Pose { x: x as f32, y: y as f32, angle: beta as f32 };
    std::array::from_fn(|body| match body {
        0 => hull,
        wheel => {
            let [dx, dy] = anchor(wheel - 1);
            Pose { x: hull.x + dx, y: hull.y + dy, ..hull }
        }
    })
}

/// Where wheel `i` sits on the hull, world units from the hull's origin.
pub fn anchor(i: usize) -> [f32; 2] {
    WHEELS[i].map(|v| (v * SIZE) as f32)
}

/// The original's solver, with the masses of the car.
#[derive(Clone, Copy, Debug)]
pub struct Positions {
    centre: [f32; 2],
    inverse_mass: [f32; 2],
    inverse_inertia: [f32; 2],
}

impl Default for Positions {
    fn default() -> Self {
        let masses = [shape::hull_mass(), shape::wheel_mass()];
        Self {
            centre: masses[0].centre.map(|v| v as f32),
            inverse_mass: masses.map(|mass| (1.0 / mass.mass) as f32),
            inverse_inertia: masses.map(|mass| (1.0 / mass.inertia) as f32),
        }
    }
}

impl Positions {
    /// Moves the bodies by one step, caps velocities, and pulls the joints together.
    pub fn advance(&self, poses: &mut [Pose; BODIES], velocities: &mut [Velocity; BODIES]) {
        let stops = std::array::from_fn(|i| stop(poses[i + 1].angle - poses[0].angle));
        // From here on positions are those of the centres of mass.
        let [dx, dy] = rotate(poses[0].angle, self.centre);
        (poses[0].x, poses[0].y) = (poses[0].x + dx, poses[0].y + dy);
        for (pose, velocity) in poses.iter_mut().zip(velocities) {
            move_body(pose, velocity);
        }
        self.pull_together(poses, stops);
        let [dx, dy] = rotate(poses[0].angle, self.centre);
        (poses[0].x, poses[0].y) = (poses[0].x - dx, poses[0].y - dy);
    }

    fn pull_together(&self, poses: &mut [Pose; BODIES], stops: [f32; 4]) {
        for _ in 0..SWEEPS {
            let mut done = true;
            // The original's solver begins with the joint made last.
            for i in (0..4).rev() {
                done &= self.turn_back(poses, i, stops[i]);
                done &= self.pull(poses, i) <= SLOP;
            }
            if done {
                break;
            }
        }
    }

    /// Turns joint `i` back that was at its stop (1 or -1) when the step began and is now beyond stop and slack.
    fn turn_back(&self, poses: &mut [Pose; BODIES], i: usize, stop: f32) -> bool {
        if stop == 0.0 {
            return true;
        }
        let beyond = stop * (poses[i + 1].angle - poses[0].angle) - STEER_LIMIT;
        let correction = -stop * (beyond - STEER_SLACK).clamp(0.0, STEER_CORRECTION);
        let [hull, wheel] = self.inverse_inertia;
        poses[0].angle -= correction * hull / (hull + wheel);
        poses[i + 1].angle += correction * wheel / (hull + wheel);
        beyond <= STEER_SLACK
    }

    /// Moves hull and wheel `i` so that the wheel sits at its anchor; gives the gap there was.
    fn pull(&self, poses: &mut [Pose; BODIES], i: usize) -> f32 {
        let [ax, ay] = anchor(i);
        let arm = rotate(poses[0].angle, [ax - self.centre[0], ay - self.centre[1]]);
        let gap = [poses[i + 1].x - poses[0].x - arm[0], poses[i + 1].y - poses[0].y - arm[1]];
        let ([hull, wheel], inertia) = (self.inverse_mass, self.inverse_inertia[0]);
        let (xx, yy) = (hull + wheel + inertia * arm[1] * arm[1], hull + wheel + inertia * arm[0] * arm[0]);
        let xy = -inertia * arm[0] * arm[1];
        let determinant = xx * yy - xy * xy;
        let [px, py] = [(yy * gap[0] - xy * gap[1]) / determinant, (xx * gap[1] - xy * gap[0]) / determinant];
        poses[0].x += hull * px;
        poses[0].y += hull * py;
        poses[0].angle += inertia * (arm[0] * py - arm[1] * px);
        poses[i + 1].x -= wheel * px;
        poses[i + 1].y -= wheel * py;
        (gap[0] * gap[0] + gap[1] * gap[1]).sqrt()
    }
}

/// 1 or -1 where a joint is at its stop, else 0.
pub fn stop(angle: f32) -> f32 {
    if angle >= STEER_LIMIT {
        1.0
    } else if angle <= -STEER_LIMIT {
        -1.0
    } else {
        0.0
    }
}

fn move_body(pose: &mut Pose, velocity: &mut Velocity) {
    let way = velocity.linear.map(|v| v * DT as f32);
    let length = (way[0] * way[0] + way[1] * way[1]).sqrt();
    if length > MAX_TRANSLATION {
        velocity.linear = velocity.linear.map(|v| v * (MAX_TRANSLATION / length));
    }
    pose.x += DT as f32 * velocity.linear[0];
    pose.y += DT as f32 * velocity.linear[1];
    pose.angle += DT as f32 * velocity.spin;
}

/// A vector turned by an angle.
pub fn rotate(angle: f32, [x, y]: [f32; 2]) -> [f32; 2] {
    let (sin, cos) = math::sin_cosf(angle);
    [cos * x - sin * y, sin * x + cos * y]
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_reset_pulls_the_wheels_into_place() {
        let mut poses = created(10.0, -20.0, 0.6);
        Positions::default().advance(&mut poses, &mut [Velocity::default(); BODIES]);
        for i in 0..4 {
            let [dx, dy] = rotate(poses[0].angle, anchor(i));
            let gap = (poses[i + 1].x - poses[0].x - dx).hypot(poses[i + 1].y - poses[0].y - dy);
            assert!(gap <= SLOP, "wheel {i}: {gap}");
        }
        let turned = poses[0].angle - 0.6;
        assert!((-0.05..-0.004).contains(&turned), "{turned}");
    }

    #[test]
    fn no_body_moves_farther_than_the_original_allows() {
        let mut poses = created(0.0, 0.0, 0.0);
        let mut velocities = [Velocity { linear: [0.0, 300.0], spin: 0.0 }; BODIES];
        Positions::default().advance(&mut poses, &mut velocities);
        assert!((poses[0].y - MAX_TRANSLATION).abs() < 1e-5, "{:?}", poses[0]);
        assert!(velocities.iter().all(|v| (v.linear[1] - 100.0).abs() < 1e-4), "{velocities:?}");
    }
}
