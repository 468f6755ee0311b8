//! The tyre model: engine, brake, rolling and sliding of one wheel in one step. No physics engine here.

/// Seconds per step.
pub const DT: f64 = 1.0 / 50.0;
/// The original's unit of length for the car's parts, in world units.
pub const SIZE: f64 = 0.02;
/// Wheel radius, world units.
pub const RADIUS: f64 = 27.0 * SIZE;
/// Most that the gas pedal opens per step.
const GAS_RISE: f64 = 0.1;
const AREA: f64 = SIZE * SIZE;
const ENGINE_POWER: f64 = 1e8 * AREA;
const INERTIA: f64 = 4000.0 * AREA;
const GRIP: f64 = 1e6 * AREA;
const GRASS: f64 = 0.6;
const SLIP_STIFFNESS: f64 = 205_000.0 * AREA;
/// Rotation that a full brake takes away per step, radians per second.
const BRAKE: f64 = 15.0;
/// Brake values from here on lock the wheel.
const LOCK: f64 = 0.9;
/// Fastest turn of the steering, radians per second.
const STEER_SPEED: f64 = 3.0;
const STEER_GAIN: f64 = 50.0;

/// One wheel's controls and rotation.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Tyre {
    /// Steering angle wanted, radians relative to the hull.
    pub steer: f64,
    /// Gas pedal, 0..1.
    pub gas: f64,
    /// Brake pedal, 0..1.
    pub brake: f64,
    /// Rotation speed, radians per second.
    pub omega: f64,
    /// Angle of rotation, radians, not wrapped.
    pub phase: f64,
}

/// Force of the ground on a wheel, along the wheel's own axes.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Grip {
    /// Along the rolling direction.
    pub forward: f64,
    /// To the right of it.
    pub side: f64,
}

impl Tyre {
    /// Presses the gas pedal: opens slowly, closes at once.
    pub fn set_gas(&mut self, wanted: f64) {
        self.gas += (wanted.clamp(0.0, 1.0) - self.gas).min(GAS_RISE);
    }

    /// Speed of the steering motor at the present steering angle, radians per second.
    pub fn steering_speed(&self, angle: f64) -> f64 {
        let error = self.steer - angle;
        let speed = (STEER_GAIN * error.abs()).min(STEER_SPEED);
        // Not `signum`, which is 1 at 0.
        if error > 0.0 {
            speed
        } else if error < 0.0 {
            -speed
        } else {
            0.0
        }
    }

    /// One step of the wheel's rotation against the ground. `forward` and `side`: velocity of the wheel's centre along
    /// its own axes, units per second.
    pub fn roll(&mut self, forward: f64, side: f64, on_road: bool) -> Grip {
        let limit = GRIP * if on_road { 1.0 } else { GRASS };
        self.omega += DT * ENGINE_POWER * self.gas / INERTIA / (self.omega.abs() + 5.0);
        if self.brake >= LOCK {
            self.omega = 0.0;
        } else if self.brake > 0.0 {
            let loss = (BRAKE * self.brake).min(self.omega.abs());
            self.omega -= loss.copysign(self.omega);
        }
        self.phase += self.omega * DT;
        let mut grip =
            Grip { forward: (self.omega * RADIUS - forward) * SLIP_STIFFNESS, side: -side * SLIP_STIFFNESS };
        let force = (grip.forward * grip.forward + grip.side * grip.side).sqrt();
        if force > limit {
            grip.forward *= limit / force;
            grip.side *= limit / force;
        }
        self.omega -= DT * grip.forward * RADIUS / INERTIA;
        grip
    }
}
