//! The car's parts: outlines, masses and where the wheels sit.

use super::tyre::SIZE;
use crate::physics::mass::{Mass, polygon_mass};

/// The hull's four convex parts, in units of [`SIZE`], x to the right, y forward.
pub const HULL: [&[[f64; 2]]; 4] = [
    &[[-60.0, 130.0], [60.0, 130.0], [60.0, 110.0], [-60.0, 110.0]],
    &[[-15.0, 120.0], [15.0, 120.0], [20.0, 20.0], [-20.0, 20.0]],
    &[
        [25.0, 20.0],
        [50.0, -10.0],
        [50.0, -40.0],
        [20.0, -90.0],
        [-20.0, -90.0],
        [-50.0, -40.0],
        [-50.0, -10.0],
        [-25.0, 20.0],
    ],
    &[[-50.0, -120.0], [50.0, -120.0], [50.0, -90.0], [-50.0, -90.0]],
];

/// Corners of the largest hull part.
pub const MOST_CORNERS: usize = 8;

/// Where the wheels sit on the hull, in units of [`SIZE`]: front left, front right, rear left, rear right.
pub const WHEELS: [[f64; 2]; 4] = [[-55.0, 80.0], [55.0, 80.0], [-55.0, -82.0], [55.0, -82.0]];

/// Half a wheel's width and length seen from above, in units of [`SIZE`].
pub const WHEEL_HALF: [f64; 2] = [14.0, 27.0];

const HULL_DENSITY: f64 = 1.0;
const WHEEL_DENSITY: f64 = 0.1;

/// The hull's mass: its parts overlap, and the overlaps count twice as in the original.
pub fn hull_mass() -> Mass {
    let parts = HULL.map(|part| {
        let corners: Vec<[f64; 2]> = part.iter().map(|p| p.map(|v| v * SIZE)).collect();
        polygon_mass(&corners, HULL_DENSITY)
    });
    let mass: f64 = parts.iter().map(|part| part.mass).sum();
    let centre =
        [0, 1].map(|axis| parts.iter().map(|part| part.mass * part.centre[axis]).sum::<f64>() / mass);
    let about_centre = |part: &Mass| {
        let [dx, dy] = [part.centre[0] - centre[0], part.centre[1] - centre[1]];
        part.inertia + part.mass * (dx * dx + dy * dy)
    };
    Mass { mass, centre, inertia: parts.iter().map(about_centre).sum() }
}

/// A wheel's mass.
pub fn wheel_mass() -> Mass {
    let [w, h] = WHEEL_HALF.map(|half| half * SIZE);
    polygon_mass(&[[-w, -h], [w, -h], [w, h], [-w, h]], WHEEL_DENSITY)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn masses_are_those_of_the_original() {
        let hull = hull_mass();
        assert!((hull.mass - 7.06).abs() < 1e-3, "{hull:?}");
        assert!((hull.centre[1] + 0.08253).abs() < 1e-4 && hull.centre[0].abs() < 1e-9, "{hull:?}");
        assert!((hull.inertia - 18.2123).abs() < 1e-3, "{hull:?}");
        let wheel = wheel_mass();
        assert!((wheel.mass - 0.06048).abs() < 1e-7 && (wheel.inertia - 0.0074592).abs() < 1e-6, "{wheel:?}");
    }
}
