//! Mass, centre of mass and moment of inertia of polygons.

/// Mass, centre of mass (body frame) and moment of inertia about it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Mass {
    /// Mass.
    pub mass: f64,
    /// Centre of mass, world units from the body's origin.
    pub centre: [f64; 2],
    /// Moment of inertia about the centre of mass.
    pub inertia: f64,
}

/// The mass of a polygon with uniform density: sums over triangles from the origin, with signed areas, so that the origin
/// may lie outside.
pub fn polygon_mass(corners: &[[f64; 2]], density: f64) -> Mass {
    let (mut area, mut first, mut second) = (0.0, [0.0; 2], 0.0);
    for (i, p) in corners.iter().enumerate() {
        let q = &corners[(i + 1) % corners.len()];
        let cross = p[0] * q[1] - q[0] * p[1];
        area += cross / 2.0;
        for axis in 0..2 {
            first[axis] += cross / 6.0 * (p[axis] + q[axis]);
            second += cross / 12.0 * (p[axis] * p[axis] + p[axis] * q[axis] + q[axis] * q[axis]);
        }
    }
    let centre = first.map(|moment| moment / area);
    let mass = density * area.abs();
    let about_origin = density * second.abs();
    Mass { mass, centre, inertia: about_origin - mass * (centre[0] * centre[0] + centre[1] * centre[1]) }
}
