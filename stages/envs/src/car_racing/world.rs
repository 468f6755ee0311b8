//! The car's five bodies and four joints in the physics engine.
//!
//! Nothing collides in this game, so the engine holds no collision shapes: which tiles a wheel touches is decided by
//! [`super::tiles`]. The engine solves velocities; [`super::positions`] makes positions of them.

use dril_stage_api::math;
use rapier2d::prelude::{
    GenericJoint, ImpulseJointHandle, IntegrationParameters, JointAxis, MassProperties, PhysicsWorld,
    Pose as Isometry, RevoluteJointBuilder, RigidBody, RigidBodyBuilder, RigidBodyHandle, Rotation, Vector,
};

use super::positions::{self, BODIES, Pose, Positions, Velocity, anchor, rotate};
use super::shape;
use super::steering_stop::{MOTOR_TORQUE, SteeringStop};
use super::tyre::DT;
use crate::physics::mass::Mass;

/// Gain of the engine's motor; large means that the motor's speed is met, as in the original.
const MOTOR_GAIN: f32 = 1e6;
/// Sweeps of the velocity solver. The hull weighs 117 wheels, so a single one does not converge.
const SWEEPS: usize = 4;

/// One body's motion.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Motion {
    /// Origin, world units.
    pub position: [f64; 2],
    /// Cosine and sine of the angle.
    pub cos_sin: [f64; 2],
    /// Velocity of the centre of mass, units per second.
    pub velocity: [f64; 2],
    /// Rotation, radians per second.
    pub spin: f64,
}

impl Motion {
    fn new(pose: &Pose, velocity: &Velocity) -> Self {
        let (sin, cos) = math::sin_cos(f64::from(pose.angle));
        Self {
            position: [f64::from(pose.x), f64::from(pose.y)],
            cos_sin: [cos, sin],
            velocity: velocity.linear.map(f64::from),
            spin: f64::from(velocity.spin),
        }
    }

    /// The point with these coordinates in the body's frame.
    pub fn point(&self, [x, y]: [f64; 2]) -> [f64; 2] {
        let [cos, sin] = self.cos_sin;
        [self.position[0] + cos * x - sin * y, self.position[1] + sin * x + cos * y]
    }
}

/// The car in the engine.
pub struct CarWorld {
    physics: PhysicsWorld,
    bodies: [RigidBodyHandle; BODIES],
    joints: [ImpulseJointHandle; 4],
    positions: Positions,
    poses: [Pose; BODIES],
    velocities: [Velocity; BODIES],
    motions: [Motion; BODIES],
    stops: [SteeringStop; 4],
    wheel_inertia: f32,
}

impl CarWorld {
    /// A car at rest.
    pub fn new(poses: [Pose; BODIES]) -> Self {
        let mut physics = PhysicsWorld::new();
        physics.gravity = Vector::new(0.0, 0.0);
        physics.integration_parameters = integration_parameters();
        let masses = [shape::hull_mass(), shape::wheel_mass()];
        let bodies = std::array::from_fn(|i| physics.insert_body(body(&masses[i.min(1)])));
        let joints =
            std::array::from_fn(|i| physics.insert_impulse_joint(bodies[0], bodies[i + 1], joint(i)));
        let mut world = Self {
            physics,
            bodies,
            joints,
            positions: Positions::default(),
            poses,
            velocities: [Velocity::default(); BODIES],
            motions: [Motion::default(); BODIES],
            stops: [SteeringStop::default(); 4],
            wheel_inertia: masses[1].inertia as f32,
        };
        world.hand_over();
        world
    }

    /// Pulls the joints together without letting time pass, as the original's reset does.
    pub fn settle(&mut self) {
        self.positions.advance(&mut self.poses, &mut self.velocities);
        self.hand_over();
    }

    /// The hull's motion.
    pub fn hull(&self) -> &Motion {
        &self.motions[0]
    }

    /// The wheels' motion.
    pub fn wheels(&self) -> &[Motion] {
        &self.motions[1..]
    }

    /// The hull's angle, radians, not wrapped.
    pub fn hull_angle(&self) -> f64 {
        f64::from(self.poses[0].angle)
    }

    /// Angle of wheel `i` relative to the hull, radians.
    pub fn joint_angle(&self, i: usize) -> f64 {
        f64::from(self.poses[i + 1].angle - self.poses[0].angle)
    }

    /// Gives all bodies other poses and velocities. The steering joints forget what pressed them.
    pub fn place(&mut self, poses: [Pose; BODIES], velocities: [Velocity; BODIES]) {
        (self.poses, self.velocities) = (poses, velocities);
        self.stops = [SteeringStop::default(); 4];
        self.hand_over();
    }

    /// What holds each wheel's steering joint at its stop.
    pub fn stops(&self) -> &[SteeringStop; 4] {
        &self.stops
    }

    /// Poses of the bodies.
    pub fn poses(&self) -> &[Pose; BODIES] {
        &self.poses
    }

    /// Moves the world on by one step under `forces` (world axes) on the wheels' centres, while the steering motors run
    /// at `speeds` (radians per second).
    pub fn step(&mut self, speeds: [f64; 4], forces: [[f64; 2]; 4]) {
        self.steer(speeds);
        for (wheel, [x, y]) in self.bodies[1..].iter().zip(forces) {
            let wheel = &mut self.physics.bodies[*wheel];
            wheel.reset_forces(true);
            wheel.add_force(Vector::new(x as f32, y as f32), true);
        }
        self.physics.step();
        for i in 0..BODIES {
            let body = &self.physics.bodies[self.bodies[i]];
            if i > 0 {
                // Nothing but its joint's motor and stop turns a wheel.
                self.stops[i - 1].end_step(self.wheel_inertia * (body.angvel() - self.velocities[i].spin));
            }
            self.velocities[i] = Velocity { linear: [body.linvel().x, body.linvel().y], spin: body.angvel() };
        }
        self.positions.advance(&mut self.poses, &mut self.velocities);
        self.hand_over();
    }

    /// Sets the steering motors' speeds, radians per second. Not by `get_mut`: for each joint got so the engine would
    /// look through its islands in the next step, and allocate a list of them.
    fn steer(&mut self, speeds: [f64; 4]) {
        let targets: [f32; 4] = std::array::from_fn(|i| {
            let angle = self.poses[i + 1].angle - self.poses[0].angle;
            let rate = self.velocities[i + 1].spin - self.velocities[0].spin;
            self.stops[i].joint_speed(positions::stop(angle), speeds[i] as f32, rate)
        });
        let joints = &self.joints;
        self.physics.impulse_joints.map_attached_joints_mut(self.bodies[0], |_, _, handle, joint| {
            let Some(i) = joints.iter().position(|joint| *joint == handle) else { return };
            joint.data.motors[JointAxis::AngX as usize].target_vel = targets[i];
        });
    }

    /// Tells the engine where the bodies are. It gets the wheels exactly on their joints, since it would turn what the
    /// original leaves of a gap into speed.
    fn hand_over(&mut self) {
        for i in 0..BODIES {
            self.motions[i] = Motion::new(&self.poses[i], &self.velocities[i]);
            let (hull, velocity) = (&self.poses[0], &self.velocities[i]);
            let [dx, dy] = if i == 0 { [0.0; 2] } else { rotate(hull.angle, anchor(i - 1)) };
            let at = Vector::new(hull.x + dx, hull.y + dy);
            let body = &mut self.physics.bodies[self.bodies[i]];
            body.set_position(Isometry::from_parts(at, Rotation::new(self.poses[i].angle)), true);
            body.set_linvel(Vector::new(velocity.linear[0], velocity.linear[1]), true);
            body.set_angvel(velocity.spin, true);
        }
    }
}

fn integration_parameters() -> IntegrationParameters {
    IntegrationParameters {
        dt: DT as f32,
        num_solver_iterations: 1,
        num_internal_pgs_iterations: SWEEPS,
        num_internal_stabilization_iterations: 1,
        max_ccd_substeps: 0,
        contact_recycling: false,
        normalized_max_linear_velocity: f32::MAX,
        ..IntegrationParameters::default()
    }
}

fn body(mass: &Mass) -> RigidBody {
    let centre = Vector::new(mass.centre[0] as f32, mass.centre[1] as f32);
    let properties = MassProperties::new(centre, mass.mass as f32, mass.inertia as f32);
    RigidBodyBuilder::dynamic().additional_mass_properties(properties).can_sleep(false).build()
}

fn joint(i: usize) -> GenericJoint {
    let [x, y] = anchor(i);
    RevoluteJointBuilder::new()
        .local_anchor1(Vector::new(x, y))
        .local_anchor2(Vector::new(0.0, 0.0))
        .motor_velocity(0.0, MOTOR_GAIN)
        .motor_max_force(MOTOR_TORQUE)
        .contacts_enabled(false)
        .build()
        .into()
}
