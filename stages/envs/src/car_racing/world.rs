//! The car's five bodies and four joints in the physics engine, with the settings that make it follow the original's.
//!
//! Nothing collides in this game, so the engine holds no collision shapes: which tiles a wheel touches is decided by
//! [`super::tiles`].

use rapier2d::prelude::{
    GenericJoint, ImpulseJointHandle, IntegrationParameters, JointAxis, MassProperties, PhysicsWorld,
    Pose as Isometry, RevoluteJointBuilder, RigidBody, RigidBodyBuilder, RigidBodyHandle, Rotation, Vector,
};

use super::settle::{CarPose, Pose};
use super::shape::{self, Mass, WHEELS};
use super::tyre::{DT, SIZE};

/// Steering stops at this angle, radians.
const STEER_LIMIT: f64 = 0.4;
/// The original lets a joint overshoot its stop by this much before it pulls back: two degrees.
const STEER_SLACK: f64 = 2.0 * std::f64::consts::PI / 180.0;
/// Strongest torque of a steering motor.
const MOTOR_TORQUE: f32 = (180.0 * 900.0 * SIZE * SIZE) as f32;
/// Gain of the engine's motor; large means that the motor's speed is met, as in the original.
const MOTOR_GAIN: f32 = 1e6;
/// Fastest body, units per second: the original moves a body at most 2 units a step.
const SPEED_LIMIT: f32 = 100.0;
/// Sweeps of the velocity solver. The hull weighs 117 wheels, so fewer do not converge.
const SWEEPS: usize = 20;

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
    /// The angle, radians in (-pi, pi].
    pub fn angle(&self) -> f64 {
        self.cos_sin[1].atan2(self.cos_sin[0])
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
    hull: RigidBodyHandle,
    wheels: [RigidBodyHandle; 4],
    joints: [ImpulseJointHandle; 4],
}

impl CarWorld {
    /// A car at rest.
    pub fn new(pose: &CarPose) -> Self {
        let mut physics = PhysicsWorld::new();
        physics.gravity = Vector::new(0.0, 0.0);
        physics.integration_parameters = integration_parameters();
        let hull = physics.insert_body(body(&pose.hull, &shape::hull_mass()));
        let wheel = shape::wheel_mass();
        let wheels = pose.wheels.map(|pose| physics.insert_body(body(&pose, &wheel)));
        let joints = std::array::from_fn(|i| physics.insert_impulse_joint(hull, wheels[i], joint(i)));
        Self { physics, hull, wheels, joints }
    }

    /// The hull's motion.
    pub fn hull(&self) -> Motion {
        motion(&self.physics.bodies[self.hull])
    }

    /// The wheels' motion.
    pub fn wheels(&self) -> [Motion; 4] {
        self.wheels.map(|wheel| motion(&self.physics.bodies[wheel]))
    }

    /// Gives a body another motion: 0 is the hull, 1 to 4 are the wheels.
    pub fn set_motion(&mut self, body: usize, pose: &Pose, velocity: [f32; 2], spin: f32) {
        let handle = if body == 0 { self.hull } else { self.wheels[body - 1] };
        let body = &mut self.physics.bodies[handle];
        body.set_position(isometry(pose), true);
        body.set_linvel(Vector::new(velocity[0], velocity[1]), true);
        body.set_angvel(spin, true);
    }

    /// Moves the world on by one step under `forces` (world axes) on the wheels' centres, while the steering motors run
    /// at `speeds` (radians per second).
    pub fn step(&mut self, speeds: [f64; 4], forces: [[f64; 2]; 4]) {
        for i in 0..4 {
            let target = self.motor_target(i, speeds[i]);
            if let Some(joint) = self.physics.impulse_joints.get_mut(self.joints[i], false) {
                joint.data.motors[JointAxis::AngX as usize].target_vel = target as f32;
            }
            let wheel = &mut self.physics.bodies[self.wheels[i]];
            wheel.reset_forces(true);
            wheel.add_force(Vector::new(forces[i][0] as f32, forces[i][1] as f32), true);
        }
        self.physics.step();
    }

    /// Angle of wheel `i` relative to the hull, radians.
    pub fn joint_angle(&self, i: usize) -> f64 {
        let hull = self.physics.bodies[self.hull].rotation();
        let wheel = self.physics.bodies[self.wheels[i]].rotation();
        let (sin, cos) = (
            f64::from(wheel.sin()) * f64::from(hull.cos()) - f64::from(wheel.cos()) * f64::from(hull.sin()),
            f64::from(wheel.cos()) * f64::from(hull.cos()) + f64::from(wheel.sin()) * f64::from(hull.sin()),
        );
        sin.atan2(cos)
    }

    /// The motor speed that ends where the original's limited joint ends: at its stop the motor pushes no further, and
    /// only what lies beyond stop and slack is pulled back.
    fn motor_target(&self, i: usize, speed: f64) -> f64 {
        let angle = self.joint_angle(i);
        let (over, under) = (angle >= STEER_LIMIT, angle <= -STEER_LIMIT);
        let held = (over && speed > 0.0) || (under && speed < 0.0);
        let mut wanted = angle + if held { 0.0 } else { speed * DT };
        if over || under {
            let most = STEER_LIMIT + STEER_SLACK;
            wanted = wanted.clamp(-most, most);
        }
        (wanted - angle) / DT
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
        normalized_max_linear_velocity: SPEED_LIMIT,
        ..IntegrationParameters::default()
    }
}

fn body(pose: &Pose, mass: &Mass) -> RigidBody {
    let centre = Vector::new(mass.centre[0] as f32, mass.centre[1] as f32);
    let properties = MassProperties::new(centre, mass.mass as f32, mass.inertia as f32);
    RigidBodyBuilder::dynamic()
        .pose(isometry(pose))
        .additional_mass_properties(properties)
        .can_sleep(false)
        .build()
}

fn isometry(pose: &Pose) -> Isometry {
    Isometry::from_parts(Vector::new(pose.x, pose.y), Rotation::new(pose.angle))
}

fn joint(i: usize) -> GenericJoint {
    let [x, y] = WHEELS[i].map(|v| (v * SIZE) as f32);
    RevoluteJointBuilder::new()
        .local_anchor1(Vector::new(x, y))
        .local_anchor2(Vector::new(0.0, 0.0))
        .motor_velocity(0.0, MOTOR_GAIN)
        .motor_max_force(MOTOR_TORQUE)
        .contacts_enabled(false)
        .build()
        .into()
}

fn motion(body: &RigidBody) -> Motion {
    let (position, rotation, velocity) = (body.translation(), body.rotation(), body.linvel());
    Motion {
        position: [f64::from(position.x), f64::from(position.y)],
        cos_sin: [f64::from(rotation.cos()), f64::from(rotation.sin())],
        velocity: [f64::from(velocity.x), f64::from(velocity.y)],
        spin: f64::from(body.angvel()),
    }
}
