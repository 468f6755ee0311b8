//! Where the car stands after the original's reset.
//!
//! The original creates the wheels beside an unrotated hull, and its engine pulls them into place in the reset's one
//! step by moving positions only: sequential position correction of the four joints, which also turns the hull by up to
//! 0.05 rad. The same few sweeps here give the same start.

use super::shape::{self, WHEELS};
use super::tyre::SIZE;

/// Sweeps of the original's solver.
const SWEEPS: usize = 60;
/// Distance that it leaves as it is, world units.
const SLOP: f32 = 0.005;

/// Position of a body's origin, and its angle.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Pose {
    /// World units.
    pub x: f32,
    /// World units.
    pub y: f32,
    /// Radians, forward is (-sin, cos).
    pub angle: f32,
}

/// Poses of the hull and the four wheels.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct CarPose {
    /// The hull.
    pub hull: Pose,
    /// Front left, front right, rear left, rear right.
    pub wheels: [Pose; 4],
}

/// The car as the original creates it: hull turned to `beta`, wheels turned but not moved with it.
pub fn created(x: f64, y: f64, beta: f64) -> CarPose {
    let (x, y, angle) = (x as f32, y as f32, beta as f32);
    let wheel = |i: usize| {
        let [dx, dy] = WHEELS[i].map(|v| (v * SIZE) as f32);
        Pose { x: x + dx, y: y + dy, angle }
    };
    CarPose { hull: Pose { x, y, angle }, wheels: std::array::from_fn(wheel) }
}

/// The car once the joints have been pulled together.
pub fn settled(created: &CarPose) -> CarPose {
    let (hull, wheel) = (shape::hull_mass(), shape::wheel_mass());
    let local_centre = hull.centre.map(|v| v as f32);
    let mut a = Body::new(created.hull, local_centre, &hull);
    let mut wheels = created.wheels.map(|pose| Body::new(pose, [0.0; 2], &wheel));
    for _ in 0..SWEEPS {
        let mut done = true;
        // The original's islands start at the body created last.
        for i in (0..4).rev() {
            let anchor = [0, 1].map(|axis| (WHEELS[i][axis] * SIZE) as f32 - local_centre[axis]);
            done &= pull_together(&mut a, anchor, &mut wheels[i]) <= SLOP;
        }
        if done {
            break;
        }
    }
    let hull = a.pose(local_centre);
    // The engine here would turn what the original leaves of the gaps into speed, so they are closed.
    let place = |i: usize| wheel_on(&hull, i, wheels[i].angle);
    CarPose { hull, wheels: std::array::from_fn(place) }
}

/// The pose of wheel `i` on its joint, with the given angle in the world.
pub fn wheel_on(hull: &Pose, i: usize, angle: f32) -> Pose {
    let [dx, dy] = rotate(hull.angle, WHEELS[i].map(|v| (v * SIZE) as f32));
    Pose { x: hull.x + dx, y: hull.y + dy, angle }
}

struct Body {
    centre: [f32; 2],
    angle: f32,
    inverse_mass: f32,
    inverse_inertia: f32,
}

impl Body {
    fn new(pose: Pose, local_centre: [f32; 2], mass: &shape::Mass) -> Self {
        let [dx, dy] = rotate(pose.angle, local_centre);
        Self {
            centre: [pose.x + dx, pose.y + dy],
            angle: pose.angle,
            inverse_mass: (1.0 / mass.mass) as f32,
            inverse_inertia: (1.0 / mass.inertia) as f32,
        }
    }

    fn pose(&self, local_centre: [f32; 2]) -> Pose {
        let [dx, dy] = rotate(self.angle, local_centre);
        Pose { x: self.centre[0] - dx, y: self.centre[1] - dy, angle: self.angle }
    }

    fn push(&mut self, at: [f32; 2], impulse: [f32; 2]) {
        self.centre[0] += self.inverse_mass * impulse[0];
        self.centre[1] += self.inverse_mass * impulse[1];
        self.angle += self.inverse_inertia * (at[0] * impulse[1] - at[1] * impulse[0]);
    }
}

/// Moves hull and wheel so that the wheel's centre is at the anchor; gives the distance there was.
fn pull_together(hull: &mut Body, anchor: [f32; 2], wheel: &mut Body) -> f32 {
    let r = rotate(hull.angle, anchor);
    let gap = [0, 1].map(|axis| wheel.centre[axis] - hull.centre[axis] - r[axis]);
    let mass = hull.inverse_mass + wheel.inverse_mass;
    let (xx, yy) = (mass + hull.inverse_inertia * r[1] * r[1], mass + hull.inverse_inertia * r[0] * r[0]);
    let xy = -hull.inverse_inertia * r[0] * r[1];
    let determinant = xx * yy - xy * xy;
    let impulse = [-(yy * gap[0] - xy * gap[1]) / determinant, -(xx * gap[1] - xy * gap[0]) / determinant];
    hull.push(r, impulse.map(|v| -v));
    wheel.push([0.0; 2], impulse);
    (gap[0] * gap[0] + gap[1] * gap[1]).sqrt()
}

fn rotate(angle: f32, [x, y]: [f32; 2]) -> [f32; 2] {
    let (sin, cos) = angle.sin_cos();
    [cos * x - sin * y, sin * x + cos * y]
}
