//! The steering joint at its stop, which remembers how hard it was pressed.
//!
//! The original's engine (Box2D) solves a joint's motor and its stop one after the other, 180 times a step. At the stop
//! the motor's share sets the joint moving and the stop's share takes that back, each time. Both sums are kept for the
//! next step, and grow until the motor's reaches its largest impulse. When the motor turns away, the stop's sum has to
//! unwind first: a joint that was pressed hard and is called back slowly stays where it is for some steps, and one that
//! comes free in the last of the 180 sweeps gets only a part of its speed.

use super::shape;
use super::tyre::{DT, SIZE};

/// Strongest torque of a steering motor.
pub(super) const MOTOR_TORQUE: f32 = (180.0 * 900.0 * SIZE * SIZE) as f32;
/// Impulse of the strongest torque over one step: the most that the sums wind up to.
const LARGEST_IMPULSE: f32 = MOTOR_TORQUE * DT as f32;
/// Times per step that the original solves a joint's motor and stop.
const SWEEPS: f32 = 180.0;

/// What holds a steering joint at its stop.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SteeringStop {
    /// Impulse that changes the speed between hull and wheel by one radian per second.
    motor_mass: f32,
    /// The stop that the joint was at in the last step.
    side: f32,
    /// The motor's sum, from the hull to the wheel.
    motor: f32,
    /// The stop's sum, away from the stop.
    hold: f32,
    /// The joint's speed before the last step.
    rate: f32,
}

impl Default for SteeringStop {
    fn default() -> Self {
        let [hull, wheel] = [shape::hull_mass(), shape::wheel_mass()].map(|mass| 1.0 / mass.inertia);
        Self { motor_mass: (1.0 / (hull + wheel)) as f32, side: 0.0, motor: 0.0, hold: 0.0, rate: 0.0 }
    }
}

impl SteeringStop {
    /// The impulse by which the stop holds the joint against its motor, from 0 to about 1.3.
    pub fn hold(&self) -> f32 {
        self.hold
    }

    /// The speed (radians per second) that the joint has after a step in which its motor is asked for `speed`: 0 while
    /// the stop holds it. `side` is 1 or -1 at a stop and 0 elsewhere, `rate` the joint's speed before the step.
    pub fn joint_speed(&mut self, side: f32, speed: f32, rate: f32) -> f32 {
        // A joint that arrives at a stop has not pressed it yet.
        let before = if side == self.side { self.hold } else { 0.0 };
        // The solver begins with the impulses of the last step, which change the joint's speed as they did then.
        let first = 2.0 * rate - self.rate;
        (self.side, self.rate) = (side, rate);
        // The stop takes what the motor gives, and the speed that the joint comes with.
        let motor = self.drive(self.drive(self.motor, speed - first), (SWEEPS - 1.0) * speed);
        let hold = before + side * (motor - self.motor + self.motor_mass * first);
        if side != 0.0 && (hold > 0.0 || side * speed > 0.0) {
            (self.motor, self.hold) = (motor, hold.max(0.0));
            return 0.0;
        }
        self.hold = 0.0;
        // What is left of the last sweep when the stop lets go; all earlier ones give the whole speed.
        if side == 0.0 { speed } else { -side * (-hold / self.motor_mass).min(speed.abs()) }
    }

    /// Ends a step in which motor and stop together gave the wheel this angular impulse.
    pub fn end_step(&mut self, wheel_impulse: f32) {
        if self.hold > 0.0 {
            self.hold = (self.side * (self.motor - wheel_impulse)).max(0.0);
        } else {
            self.motor = wheel_impulse;
        }
    }

    /// The motor's sum after a change of the joint's speed.
    fn drive(&self, motor: f32, change: f32) -> f32 {
        (motor + self.motor_mass * change).clamp(-LARGEST_IMPULSE, LARGEST_IMPULSE)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const WHEEL_INERTIA: f32 = 0.007_459_2;

    /// Speeds of the joint at the right stop in successive steps, on a hull that turns evenly.
    fn joint_speeds(stop: &mut SteeringStop, speeds: &[f32]) -> Vec<f32> {
        let mut rate = 0.0;
        let step = |speed: &f32| {
            let reached = stop.joint_speed(1.0, *speed, rate);
            stop.end_step(WHEEL_INERTIA * (reached - rate));
            rate = reached;
            reached
        };
        speeds.iter().map(step).collect()
    }

    #[test]
    fn a_pressed_joint_stays_held_until_its_motor_has_unwound_the_impulse() {
        for (speed, held) in [(3.0, 0), (0.98, 0), (0.96, 1), (0.4, 2), (0.1, 9)] {
            let mut stop = SteeringStop::default();
            assert_eq!(joint_speeds(&mut stop, &[3.0, 3.0]), [0.0; 2]);
            assert!((stop.hold() - 1.296).abs() < 1e-5, "{stop:?}");
            let away = joint_speeds(&mut stop, &[-speed; 12]);
            assert_eq!(away.iter().take_while(|reached| **reached == 0.0).count(), held, "{speed}");
            assert_eq!(away[held + 1], -speed);
            assert_eq!(stop.hold(), 0.0);
        }
    }

    #[test]
    fn a_joint_that_comes_free_in_the_last_sweep_gets_a_part_of_its_speed() {
        // Recorded: pressed to the full while hull and wheel turn 0.22 rad/s faster each step, then called at 0.9657.
        let mut stop = SteeringStop::default();
        for _ in 0..2 {
            stop.joint_speed(-1.0, -3.0, 0.0);
            stop.end_step(-0.22 * WHEEL_INERTIA);
        }
        let reached = stop.joint_speed(-1.0, 0.9657, 0.0);
        assert!((reached - 0.23).abs() < 0.02, "{reached}");
    }

    #[test]
    fn a_joint_called_back_right_after_it_arrived_has_its_arrival_to_unwind_as_well() {
        // Recorded: arrives at 3 rad/s and is called back at 0.985 in the next step, which it leaves at that speed.
        let mut stop = SteeringStop::default();
        for rate in [0.0, 3.0] {
            assert_eq!(stop.joint_speed(0.0, 3.0, rate), 3.0);
            stop.end_step(WHEEL_INERTIA * (3.0 - rate));
        }
        assert_eq!(stop.joint_speed(1.0, 3.0, 3.0), 0.0);
        stop.end_step(-3.0 * WHEEL_INERTIA);
        assert!(stop.hold() > 1.31, "{stop:?}");
        assert_eq!(stop.joint_speed(1.0, -0.985, 0.0), -0.985);
    }

    #[test]
    fn a_joint_that_leaves_the_stop_or_reaches_the_other_one_is_free() {
        for other in [0.0, -1.0] {
            let mut stop = SteeringStop::default();
            joint_speeds(&mut stop, &[3.0, 3.0]);
            stop.joint_speed(other, 0.0, 0.0);
            stop.end_step(0.0);
            assert_eq!(stop.joint_speed(1.0, -0.1, 0.0), -0.1, "{other}");
        }
    }

    #[test]
    fn both_stops_are_alike() {
        let (mut left, mut right) = (SteeringStop::default(), SteeringStop::default());
        for speed in [0.3, 1.0, 0.0, -0.2, -0.5, -0.9, 0.1] {
            assert_eq!(left.joint_speed(1.0, speed, 0.1), -right.joint_speed(-1.0, -speed, -0.1));
            left.end_step(0.01);
            right.end_step(-0.01);
            assert_eq!(left.hold(), right.hold());
        }
    }
}
