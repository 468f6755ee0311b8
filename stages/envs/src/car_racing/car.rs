//! The car: pedals and steering, tyres and bodies, one step at a time.

use super::positions::{BODIES, Pose};
use super::tyre::Tyre;
use super::world::{CarWorld, Motion};

/// Wheels that the engine drives.
const REAR: [usize; 2] = [2, 3];
/// Wheels that steer.
const FRONT: [usize; 2] = [0, 1];

/// What the driver does in one step.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Controls {
    /// -1 (left) to 1 (right).
    pub steer: f64,
    /// 0 to 1.
    pub gas: f64,
    /// 0 to 1.
    pub brake: f64,
}

/// The car.
pub struct Car {
    world: CarWorld,
    /// The wheels' controls and rotation: front left, front right, rear left, rear right.
    pub tyres: [Tyre; 4],
}

impl Car {
    /// A car at rest.
    pub fn new(poses: [Pose; BODIES]) -> Self {
        Self { world: CarWorld::new(poses), tyres: [Tyre::default(); 4] }
    }

    /// Sets pedals and steering.
    pub fn control(&mut self, controls: &Controls) {
        for i in FRONT {
            self.tyres[i].steer = -controls.steer;
        }
        for i in REAR {
            self.tyres[i].set_gas(controls.gas);
        }
        for tyre in &mut self.tyres {
            tyre.brake = controls.brake;
        }
    }

    /// One step of tyres and bodies. `on_road`: whether each wheel touched a tile when its contacts were last looked at.
    pub fn step(&mut self, on_road: [bool; 4]) {
        let (mut speeds, mut forces) = ([0.0; 4], [[0.0; 2]; 4]);
        for i in 0..4 {
            let Motion { cos_sin: [cos, sin], velocity: [vx, vy], .. } = self.world.wheels()[i];
            speeds[i] = self.tyres[i].steering_speed(self.world.joint_angle(i));
            let grip = self.tyres[i].roll(cos * vy - sin * vx, cos * vx + sin * vy, on_road[i]);
            forces[i] = [grip.side * cos - grip.forward * sin, grip.side * sin + grip.forward * cos];
        }
        self.world.step(speeds, forces);
    }

    /// The bodies.
    pub fn world(&self) -> &CarWorld {
        &self.world
    }

    /// The bodies, to place them elsewhere.
    pub fn world_mut(&mut self) -> &mut CarWorld {
        &mut self.world
    }

    /// The hull's motion.
    pub fn hull(&self) -> &Motion {
        self.world.hull()
    }
}
