//! The lander in the physics engine: a body with two legs on reduced-coordinate joints, over the ground.
//!
//! Joints by impulses give way when the light legs touch down; with reduced coordinates a leg cannot leave its joint.
//! Such a system is moved through its generalised coordinates, so poses and velocities are read from there.
//!
//! The engine takes the first body's generalised velocity for that of its centre of mass where it solves, and for that
//! of its origin where it moves. So the body's origin lies in its centre of mass here, and the original's beside it.

use dril_stage_api::math;
use rapier2d::prelude::{
    CoefficientCombineRule, Collider, ColliderBuilder, Group, IntegrationParameters, InteractionGroups,
    InteractionTestMode, JointAxis, MassProperties, MultibodyJointHandle, PhysicsWorld, RevoluteJointBuilder,
    RigidBodyBuilder, RigidBodyHandle, SharedShape, Vector,
};

use super::engines::Push;
use super::shape::{
    self, DT, FRICTION, GRAVITY, LANDER, LEG_HALF, LEG_SPEED, LEG_SWING, LEG_TORQUE, SCALE, SIDES, WIDTH,
    leg_arm, scaled,
};
use super::start::{Start, Velocities};
use super::terrain::Terrain;
use crate::physics::mass::Mass;

/// Sweeps of the velocity solver per step, and of the position solver.
const SWEEPS: [usize; 2] = [60, 20];
/// Gain of the legs' motors; large means that the motor's speed is met unless its torque does not suffice.
const MOTOR_GAIN: f32 = 1e6;
/// Thickness of the skin that the original's shapes have, world units.
const SKIN: f32 = 0.01;
/// A leg this close to its stop is there, radians: the original's legs are ahead of ours by up to that, since its motors
/// overshoot in the first step.
const AT_STOP: f32 = 1e-3;
/// Generalised coordinates: x, y and angle of the lander, and the angle of each leg.
const COORDINATES: usize = 5;
/// Friction of the line below the ground.
const FLOOR_FRICTION: f64 = 0.2;

/// One body's motion.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Motion {
    /// Origin, world units.
    pub position: [f32; 2],
    /// Angle, radians, not wrapped.
    pub angle: f32,
    /// Velocity of the centre of mass, units per second.
    pub velocity: [f32; 2],
    /// Rotation, radians per second.
    pub spin: f32,
}

impl Motion {
    /// The point with these coordinates in the body's frame.
    pub fn point(&self, [x, y]: [f32; 2]) -> [f32; 2] {
        let (sin, cos) = math::sin_cosf(self.angle);
        [self.position[0] + cos * x - sin * y, self.position[1] + sin * x + cos * y]
    }
}

/// The lander, its legs and the ground in the engine.
pub struct LanderWorld {
    physics: PhysicsWorld,
    lander: RigidBodyHandle,
    joint: MultibodyJointHandle,
    centre: [f32; 2],
    motions: [Motion; 3],
}

impl LanderWorld {
    /// A lander over the ground, as the reset leaves it.
    pub fn new(terrain: &Terrain, start: &Start) -> Self {
        let mut physics = PhysicsWorld::new();
        physics.gravity = Vector::new(0.0, -GRAVITY as f32);
        physics.integration_parameters = integration_parameters();
        insert_ground(&mut physics, terrain);
        let [x, y] = start.position;
        let mass = shape::lander_mass();
        let centre = mass.centre.map(|v| v as f32);
        let [dx, dy] = turned(start.angle, centre);
        let at = Vector::new(x + dx, y + dy);
        let lander = physics.bodies.insert(body(&mass).translation(at).rotation(start.angle));
        physics.colliders.insert_with_parent(lander_shape(), lander, &mut physics.bodies);
        let mut joint = MultibodyJointHandle::invalid();
        for i in 0..2 {
            let leg = physics.bodies.insert(body(&shape::leg_mass()));
            physics.colliders.insert_with_parent(leg_shape(), leg, &mut physics.bodies);
            joint = physics.multibody_joints.insert(lander, leg, leg_joint(i), true).unwrap_or(joint);
        }
        let mut world = Self { physics, lander, joint, centre, motions: [Motion::default(); 3] };
        world.place(start);
        world.look();
        (world.motions[0].velocity, world.motions[0].spin) = (start.shown.linear, start.shown.spin);
        world
    }

    /// Lander and legs.
    pub fn motions(&self) -> &[Motion; 3] {
        &self.motions
    }

    /// Moves the world on by one step under the engines' pushes.
    pub fn step(&mut self, pushes: &[Push; 2]) {
        self.run_motors();
        let middle = self.motions[0].point(self.centre);
        let lander = &mut self.physics.bodies[self.lander];
        lander.reset_forces(true);
        lander.reset_torques(true);
        for push in pushes.iter().filter(|push| push.power > 0.0) {
            // A push within a step is a force over the step. The engine's own idea of the centre of mass lags behind.
            let [fx, fy] = push.impulse.map(|v| (v / DT) as f32);
            let [ax, ay] = [0, 1].map(|axis| push.point[axis] as f32 - middle[axis]);
            lander.add_force(Vector::new(fx, fy), true);
            lander.add_torque(ax * fy - ay * fx, true);
        }
        self.physics.step();
        self.look();
    }

    /// The legs' motors turn them inwards until they are at their stops, and hold them there: the original lets a leg
    /// overshoot by what it turns in a step.
    fn run_motors(&mut self) {
        let Some((multibody, _)) = self.physics.multibody_joints.get_mut(self.joint) else { return };
        for (i, side) in SIDES.into_iter().enumerate() {
            let Some(link) = multibody.link_mut(i + 1) else { continue };
            let stopped = side as f32 * link.joint.coords().z + LEG_SWING[0] as f32 >= -AT_STOP;
            let speed = if stopped { 0.0 } else { (side * LEG_SPEED) as f32 };
            link.joint.data.motors[JointAxis::AngX as usize].target_vel = speed;
        }
    }

    /// Gives lander and legs the poses and velocities of the start.
    fn place(&mut self, start: &Start) {
        let PhysicsWorld { multibody_joints, bodies, .. } = &mut self.physics;
        let Some((multibody, _)) = multibody_joints.get_mut(self.joint) else { return };
        // The engine would damp rotations otherwise.
        multibody.damping_mut().fill(0.0);
        multibody.forward_kinematics(bodies, true);
        // It took position and rotation of the lander's body, but counts angles from 0.
        multibody.apply_displacements(&[0.0, 0.0, start.angle, start.legs[0], start.legs[1]]);
        multibody.forward_kinematics(bodies, false);
        multibody.update_rigid_bodies(bodies, true);
        let Velocities { linear: [vx, vy], spin, legs } = start.joined;
        let speeds = [vx, vy, spin, legs[0], legs[1]];
        multibody.generalized_velocity_mut().copy_from_slice(&speeds);
    }

    /// Reads where everything is. The bodies' own velocities lag behind by a step.
    fn look(&mut self) {
        let Some((multibody, _)) = self.physics.multibody_joints.get(self.joint) else { return };
        let mut speeds = [0.0; COORDINATES];
        for (speed, value) in speeds.iter_mut().zip(multibody.generalized_velocity().iter()) {
            *speed = *value;
        }
        let [vx, vy, spin, leg_speeds @ ..] = speeds;
        let coordinates = multibody.root().joint().coords();
        let angle = coordinates.z;
        let [dx, dy] = turned(angle, self.centre.map(|v| -v));
        let position = [coordinates.x + dx, coordinates.y + dy];
        self.motions[0] = Motion { position, angle, velocity: [vx, vy], spin };
        // The legs hang on the lander's origin.
        let anchor = moving([vx, vy], spin, [dx, dy]);
        for (i, leg_speed) in leg_speeds.into_iter().enumerate() {
            let Some(link) = multibody.link(i + 1) else { continue };
            let angle = angle + link.joint().coords().z;
            let [ax, ay] = turned(angle, leg_arm(i).map(|v| -v as f32));
            let spin = spin + leg_speed;
            let (position, velocity) = ([position[0] + ax, position[1] + ay], moving(anchor, spin, [ax, ay]));
            self.motions[i + 1] = Motion { position, angle, velocity, spin };
        }
    }
}

/// Velocity of a point that is `arm` away from one that moves with `velocity`, on a body that turns with `spin`.
fn moving([vx, vy]: [f32; 2], spin: f32, arm: [f32; 2]) -> [f32; 2] {
    [vx - spin * arm[1], vy + spin * arm[0]]
}

fn turned(angle: f32, [x, y]: [f32; 2]) -> [f32; 2] {
    let (sin, cos) = math::sin_cosf(angle);
    [cos * x - sin * y, sin * x + cos * y]
}

fn integration_parameters() -> IntegrationParameters {
    IntegrationParameters {
        dt: DT as f32,
        num_solver_iterations: 1,
        num_internal_pgs_iterations: SWEEPS[0],
        num_internal_stabilization_iterations: SWEEPS[1],
        max_ccd_substeps: 0,
        contact_recycling: false,
        ..IntegrationParameters::default()
    }
}

fn insert_ground(physics: &mut PhysicsWorld, terrain: &Terrain) {
    let point = |[x, y]: [f64; 2]| Vector::new(x as f32, y as f32);
    let floor = [[[0.0, 0.0], [WIDTH, 0.0]]];
    let edges = terrain.edges().map(|edge| (edge, FRICTION[2]));
    for ([from, to], friction) in floor.map(|edge| (edge, FLOOR_FRICTION)).into_iter().chain(edges) {
        let edge = ColliderBuilder::new(SharedShape::segment(point(from), point(to)));
        physics.colliders.insert(finished(edge, friction, Group::GROUP_1, Group::ALL));
    }
}

fn lander_shape() -> Collider {
    let [cx, cy] = shape::lander_mass().centre;
    let corners = scaled(LANDER).map(|[x, y]| Vector::new((x - cx) as f32, (y - cy) as f32));
    let hull = SharedShape::convex_polyline(corners.to_vec());
    // The outline is convex, so there always is a hull.
    let hull = hull.unwrap_or_else(|| SharedShape::ball((LANDER[0][1] / SCALE) as f32));
    finished(ColliderBuilder::new(hull), FRICTION[0], Group::GROUP_5, Group::GROUP_1)
}

fn leg_shape() -> Collider {
    let [w, h] = LEG_HALF.map(|half| (half / SCALE) as f32);
    finished(ColliderBuilder::cuboid(w, h), FRICTION[1], Group::GROUP_6, Group::GROUP_1)
}

fn finished(shape: ColliderBuilder, friction: f64, member: Group, filter: Group) -> Collider {
    shape
        .density(0.0)
        .friction(friction as f32)
        .friction_combine_rule(CoefficientCombineRule::GeometricMean)
        .restitution(0.0)
        .contact_skin(SKIN)
        .collision_groups(InteractionGroups::new(member, filter, InteractionTestMode::And))
        .build()
}

fn body(mass: &Mass) -> RigidBodyBuilder {
    let properties = MassProperties::new(Vector::new(0.0, 0.0), mass.mass as f32, mass.inertia as f32);
    RigidBodyBuilder::dynamic().additional_mass_properties(properties).can_sleep(false)
}

fn leg_joint(i: usize) -> RevoluteJointBuilder {
    let [x, y] = leg_arm(i).map(|v| v as f32);
    let [cx, cy] = shape::lander_mass().centre.map(|v| v as f32);
    // The motor may run past the inner stop by what it turns in a step.
    let [inner, outer] = [LEG_SWING[0] - LEG_SPEED * DT, LEG_SWING[1]];
    let stops = [inner, outer].map(|angle| (-SIDES[i] * angle) as f32);
    RevoluteJointBuilder::new()
        .local_anchor1(Vector::new(-cx, -cy))
        .local_anchor2(Vector::new(x, y))
        .motor_velocity((SIDES[i] * LEG_SPEED) as f32, MOTOR_GAIN)
        .motor_max_force(LEG_TORQUE as f32)
        .limits([stops[0].min(stops[1]), stops[0].max(stops[1])])
        .contacts_enabled(false)
}
