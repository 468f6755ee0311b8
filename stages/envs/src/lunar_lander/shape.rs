//! The lander's parts and its world: outlines, masses and sizes, as the original gives them.

use crate::physics::mass::{Mass, polygon_mass};

/// The original's pixels per world unit; its lengths are given in pixels.
pub const SCALE: f64 = 30.0;
/// Width of the world, units.
pub const WIDTH: f64 = 600.0 / SCALE;
/// Height of the world, units; the lander starts at its top.
pub const HEIGHT: f64 = 400.0 / SCALE;
/// Seconds per step.
pub const DT: f64 = 1.0 / 50.0;
/// Downwards, units per second squared.
pub const GRAVITY: f64 = 10.0;

/// Outline of the lander's body, pixels, clockwise from the upper left.
pub const LANDER: [[f64; 2]; 6] =
    [[-14.0, 17.0], [-17.0, 0.0], [-17.0, -10.0], [17.0, -10.0], [17.0, 0.0], [14.0, 17.0]];
/// Half a leg's width and length, pixels.
pub const LEG_HALF: [f64; 2] = [2.0, 8.0];
/// Outline of a leg, pixels.
pub const LEG: [[f64; 2]; 4] = {
    let [w, h] = LEG_HALF;
    [[-w, h], [-w, -h], [w, -h], [w, h]]
};
/// Where a leg hangs on its joint: this far inwards and up from its own middle, pixels.
pub const LEG_ARM: [f64; 2] = [20.0, 18.0];
/// The legs' sides: the first is the right one.
pub const SIDES: [f64; 2] = [-1.0, 1.0];

/// Angle at which a leg is created, radians against the lander, times its side.
pub const LEG_START: f64 = 0.05;
/// Angles between which a leg may swing, radians against the lander, times minus its side. The original counts them, 0.4
/// to 0.9, from the angle at which the leg is created.
pub const LEG_SWING: [f64; 2] = [0.4 - LEG_START, 0.9 - LEG_START];
/// Speed at which a leg's motor turns it, radians per second, times its side: it presses the leg inwards.
pub const LEG_SPEED: f64 = 0.3;
/// Strongest torque of a leg's motor.
pub const LEG_TORQUE: f64 = 40.0;

const LANDER_DENSITY: f64 = 5.0;
const LEG_DENSITY: f64 = 1.0;

/// Friction of the lander's body, of a leg, and of the ground; the mean of two is geometric.
pub const FRICTION: [f64; 3] = [0.1, 0.2, 0.1];

/// An outline in world units.
pub fn scaled<const N: usize>(outline: [[f64; 2]; N]) -> [[f64; 2]; N] {
    outline.map(|corner| corner.map(|v| v / SCALE))
}

/// Mass of the lander's body.
pub fn lander_mass() -> Mass {
    polygon_mass(&scaled(LANDER), LANDER_DENSITY)
}

/// Mass of a leg.
pub fn leg_mass() -> Mass {
    polygon_mass(&scaled(LEG), LEG_DENSITY)
}

/// Where leg `i` hangs, in its own frame, world units from its middle.
pub fn leg_arm(i: usize) -> [f64; 2] {
    [SIDES[i] * LEG_ARM[0] / SCALE, LEG_ARM[1] / SCALE]
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn masses_are_those_of_the_original() {
        let lander = lander_mass();
        assert!((lander.mass - 4.81667).abs() < 1e-4, "{lander:?}");
        assert!((lander.centre[1] - 0.101307).abs() < 1e-5 && lander.centre[0].abs() < 1e-9, "{lander:?}");
        let about_origin = lander.inertia + lander.mass * lander.centre[1] * lander.centre[1];
        assert!((about_origin - 0.83331).abs() < 1e-4, "{lander:?}");
        let leg = leg_mass();
        assert!((leg.mass - 0.07111).abs() < 1e-5 && (leg.inertia - 0.0017909).abs() < 1e-6, "{leg:?}");
    }
}
