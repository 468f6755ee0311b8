//! How an episode starts: the step inside the original's reset.
//!
//! The original creates the legs off their joints and outside the angles in which they may swing, and its engine pulls
//! them into place during that step, positions only, while gravity and a random push already act. What comes out depends
//! on the order of its corrections, so they are made here in the same order: first velocities, joint by joint (motor,
//! then stop and anchor together), then positions (stop, then anchor). From then on the physics engine takes over.

use dril_stage_api::math;

use super::shape::{
    self, DT, GRAVITY, HEIGHT, LEG_SPEED, LEG_START, LEG_SWING, LEG_TORQUE, SIDES, WIDTH, leg_arm,
};
use crate::physics::mass::Mass;

/// Sweeps over the joints: velocities, then positions.
const SWEEPS: [usize; 2] = [180, 60];
/// Gap that is left as it is, world units.
const SLOP: f32 = 0.005;
/// Angle beyond a stop that is left as it is, radians: two degrees.
const ANGLE_SLOP: f32 = 2.0 / 180.0 * std::f32::consts::PI;
/// Most that a joint is turned in one sweep: eight degrees.
const TURN: f32 = 4.0 * ANGLE_SLOP;

/// The lander and its legs after the reset.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Start {
    /// The lander's origin, world units.
    pub position: [f32; 2],
    /// Its angle, radians.
    pub angle: f32,
    /// The legs' angles against the lander, radians.
    pub legs: [f32; 2],
    /// Velocities as the first observation shows them. They fit the places from which the legs were pulled.
    pub shown: Velocities,
    /// Velocities that fit the joints as they are: what the original's next step makes of them.
    pub joined: Velocities,
}

/// How lander and legs move.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Velocities {
    /// Velocity of the lander's centre of mass, units per second.
    pub linear: [f32; 2],
    /// Its rotation, radians per second.
    pub spin: f32,
    /// The legs' rotations against the lander, radians per second.
    pub legs: [f32; 2],
}

impl Start {
    /// After a push of `force` on the lander's centre of mass.
    pub fn pushed(force: [f64; 2]) -> Self {
        let mut bodies = created();
        let push = force.map(|v| v as f32);
        for (i, body) in bodies.iter_mut().enumerate() {
            let force = if i == 0 { push } else { [0.0; 2] };
            let fall = [0.0, -GRAVITY as f32];
            for axis in 0..2 {
                body.velocity[axis] += DT as f32 * (fall[axis] + body.inverse_mass * force[axis]);
            }
        }
        // The original's engine begins with the joint made last.
        let mut joints = [1, 0].map(Joint::new);
        for _ in 0..SWEEPS[0] {
            for joint in &mut joints {
                joint.solve_velocities(&mut bodies);
            }
        }
        for body in &mut bodies {
            for axis in 0..2 {
                body.centre[axis] += DT as f32 * body.velocity[axis];
            }
            body.angle += DT as f32 * body.spin;
        }
        for _ in 0..SWEEPS[1] {
            if !joints.iter().fold(false, |open, joint| open | joint.solve_positions(&mut bodies)) {
                break;
            }
        }
        let lander = &bodies[0];
        let arm = turned(lander.angle, shape::lander_mass().centre.map(|v| v as f32));
        let mut start = Self {
            position: [lander.centre[0] - arm[0], lander.centre[1] - arm[1]],
            angle: lander.angle,
            legs: [1, 2].map(|i| bodies[i].angle - lander.angle),
            shown: Velocities::of(&bodies),
            joined: Velocities::of(&bodies),
        };
        for _ in 0..SWEEPS[0] {
            joints.iter().for_each(|joint| joint.join(&mut bodies));
        }
        start.joined = Velocities::of(&bodies);
        start
    }
}

impl Velocities {
    fn of([lander, right, left]: &[Body; 3]) -> Self {
        let legs = [right.spin - lander.spin, left.spin - lander.spin];
        Self { linear: lander.velocity, spin: lander.spin, legs }
    }
}

/// A body by its centre of mass.
#[derive(Clone, Copy)]
struct Body {
    centre: [f32; 2],
    angle: f32,
    velocity: [f32; 2],
    spin: f32,
    inverse_mass: f32,
    inverse_inertia: f32,
}

/// The lander and its legs as the original creates them.
fn created() -> [Body; 3] {
    let body = |mass: Mass, [x, y]: [f64; 2], angle: f64| Body {
        centre: [(x + mass.centre[0]) as f32, (y + mass.centre[1]) as f32],
        angle: angle as f32,
        velocity: [0.0; 2],
        spin: 0.0,
        inverse_mass: (1.0 / mass.mass) as f32,
        inverse_inertia: (1.0 / mass.inertia) as f32,
    };
    let [x, y] = [WIDTH / 2.0, HEIGHT];
    let leg = |i: usize| body(shape::leg_mass(), [x - leg_arm(i)[0], y], LEG_START * SIDES[i]);
    [body(shape::lander_mass(), [x, y], 0.0), leg(0), leg(1)]
}

/// The joint of a leg, which is beyond its inner stop during the whole step.
struct Joint {
    leg: usize,
    side: f32,
    anchors: [[f32; 2]; 2],
    motor: f32,
    stop: f32,
}

impl Joint {
    fn new(leg: usize) -> Self {
        let anchors = [shape::lander_mass().centre.map(|v| -v as f32), leg_arm(leg).map(|v| v as f32)];
        Self { leg: leg + 1, side: SIDES[leg] as f32, anchors, motor: 0.0, stop: 0.0 }
    }

    /// From the bodies' centres to the joint.
    fn arms(&self, bodies: &[Body; 3]) -> [[f32; 2]; 2] {
        [turned(bodies[0].angle, self.anchors[0]), turned(bodies[self.leg].angle, self.anchors[1])]
    }

    fn solve_velocities(&mut self, bodies: &mut [Body; 3]) {
        let turning = bodies[0].inverse_inertia + bodies[self.leg].inverse_inertia;
        let off = bodies[self.leg].spin - bodies[0].spin - self.side * LEG_SPEED as f32;
        let most = (DT * LEG_TORQUE) as f32;
        let motor = (self.motor - off / turning).clamp(-most, most);
        self.push(bodies, [[0.0; 2]; 2], [0.0; 2], motor - self.motor);
        self.motor = motor;

        let arms = self.arms(bodies);
        let k = stiffness(bodies[0], bodies[self.leg], arms);
        let gap = self.opening(bodies, arms);
        let spin = bodies[self.leg].spin - bodies[0].spin;
        let mut pull = solve3(&k, [-gap[0], -gap[1], -spin]);
        // The stop only pushes the leg outwards.
        if self.side * (self.stop + pull[2]) > 0.0 {
            let rest = [-gap[0] + self.stop * k[0][2], -gap[1] + self.stop * k[1][2]];
            let [x, y] = solve2(&k, rest);
            pull = [x, y, -self.stop];
        }
        self.stop += pull[2];
        self.push(bodies, arms, [pull[0], pull[1]], pull[2]);
    }

    /// Makes lander and leg move together at the joint.
    fn join(&self, bodies: &mut [Body; 3]) {
        let arms = self.arms(bodies);
        let gap = self.opening(bodies, arms);
        let pull = solve2(&stiffness(bodies[0], bodies[self.leg], arms), gap.map(|v| -v));
        self.push(bodies, arms, pull, 0.0);
    }

    /// Speed at which the joint comes apart.
    fn opening(&self, bodies: &[Body; 3], arms: [[f32; 2]; 2]) -> [f32; 2] {
        let at = |body: &Body, [x, y]: [f32; 2]| {
            [body.velocity[0] - body.spin * y, body.velocity[1] + body.spin * x]
        };
        let (lander, leg) = (at(&bodies[0], arms[0]), at(&bodies[self.leg], arms[1]));
        [leg[0] - lander[0], leg[1] - lander[1]]
    }

    /// An impulse and a turn on the leg, and the opposite on the lander.
    fn push(&self, bodies: &mut [Body; 3], arms: [[f32; 2]; 2], pull: [f32; 2], turn: f32) {
        for (index, sign, arm) in [(0, -1.0, arms[0]), (self.leg, 1.0, arms[1])] {
            let body = &mut bodies[index];
            body.velocity[0] += sign * body.inverse_mass * pull[0];
            body.velocity[1] += sign * body.inverse_mass * pull[1];
            body.spin += sign * body.inverse_inertia * (arm[0] * pull[1] - arm[1] * pull[0] + turn);
        }
    }

    /// Moves the bodies together; true while that is not enough.
    fn solve_positions(&self, bodies: &mut [Body; 3]) -> bool {
        let leg = self.leg;
        let beyond = self.side * (bodies[leg].angle - bodies[0].angle) + LEG_SWING[0] as f32;
        let turning = bodies[0].inverse_inertia + bodies[leg].inverse_inertia;
        let turn = -self.side * (beyond - ANGLE_SLOP).clamp(0.0, TURN) / turning;
        bodies[0].angle -= bodies[0].inverse_inertia * turn;
        bodies[leg].angle += bodies[leg].inverse_inertia * turn;

        let arms = self.arms(bodies);
        let gap = [0, 1]
            .map(|axis| bodies[leg].centre[axis] + arms[1][axis] - bodies[0].centre[axis] - arms[0][axis]);
        let pull = solve2(&stiffness(bodies[0], bodies[leg], arms), gap.map(|v| -v));
        for (index, sign, arm) in [(0, -1.0, arms[0]), (leg, 1.0, arms[1])] {
            let body = &mut bodies[index];
            body.centre[0] += sign * body.inverse_mass * pull[0];
            body.centre[1] += sign * body.inverse_mass * pull[1];
            body.angle += sign * body.inverse_inertia * (arm[0] * pull[1] - arm[1] * pull[0]);
        }
        math::hypotf(gap[0], gap[1]) > SLOP || beyond > ANGLE_SLOP
    }
}

/// How a joint's velocities (apart across, apart along, turning) answer to impulses.
fn stiffness(lander: Body, leg: Body, arms: [[f32; 2]; 2]) -> [[f32; 3]; 3] {
    let mass = lander.inverse_mass + leg.inverse_mass;
    let [a, b] = [lander.inverse_inertia, leg.inverse_inertia];
    let [p, q] = arms;
    let xy = -p[1] * p[0] * a - q[1] * q[0] * b;
    let (xz, yz) = (-p[1] * a - q[1] * b, p[0] * a + q[0] * b);
    [
        [mass + p[1] * p[1] * a + q[1] * q[1] * b, xy, xz],
        [xy, mass + p[0] * p[0] * a + q[0] * q[0] * b, yz],
        [xz, yz, a + b],
    ]
}

/// Solves for the first two unknowns.
fn solve2(k: &[[f32; 3]; 3], rhs: [f32; 2]) -> [f32; 2] {
    let determinant = k[0][0] * k[1][1] - k[0][1] * k[1][0];
    [(k[1][1] * rhs[0] - k[0][1] * rhs[1]) / determinant, (k[0][0] * rhs[1] - k[1][0] * rhs[0]) / determinant]
}

/// Solves for all three.
fn solve3(k: &[[f32; 3]; 3], rhs: [f32; 3]) -> [f32; 3] {
    let cross = |a: [f32; 3], b: [f32; 3]| {
        [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]]
    };
    let dot = |a: [f32; 3], b: [f32; 3]| a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
    // The matrix is symmetric: rows are columns.
    let [x, y, z] = *k;
    let determinant = dot(x, cross(y, z));
    [dot(rhs, cross(y, z)), dot(x, cross(rhs, z)), dot(x, cross(y, rhs))].map(|v| v / determinant)
}

fn turned(angle: f32, [x, y]: [f32; 2]) -> [f32; 2] {
    let (sin, cos) = math::sin_cosf(angle);
    [cos * x - sin * y, sin * x + cos * y]
}
