//! Contact between convex polygons, as in Box2D: each polygon has a thin skin.

/// Distance up to which two polygons touch: two skins of 0.01.
pub const SKIN: f32 = 0.02;

/// A point, world units.
pub type Point32 = [f32; 2];

/// True if two convex polygons (in either orientation) are closer than their skins.
pub fn touches(a: &[Point32], b: &[Point32]) -> bool {
    closer_than(a, b, SKIN)
}

/// True if two convex polygons (or a polygon and a segment) overlap or are at most `distance` apart.
#[inline]
pub fn closer_than(a: &[Point32], b: &[Point32], distance: f32) -> bool {
    let gap = widest_gap(a, b).max(widest_gap(b, a));
    if gap > distance {
        return false;
    }
    // Corner to corner, the true distance exceeds the gap of every face.
    gap <= 0.0 || squared_distance(a, b) <= distance * distance
}

/// The largest distance by which all of `b` lies outside one face of `a`; negative where it lies outside none.
fn widest_gap(a: &[Point32], b: &[Point32]) -> f32 {
    let turn = turning(a);
    let mut widest = f32::NEG_INFINITY;
    for (from, to) in edges(a) {
        let [dx, dy] = [to[0] - from[0], to[1] - from[1]];
        let length = (dx * dx + dy * dy).sqrt();
        if length == 0.0 {
            continue;
        }
        let [nx, ny] = [turn * dy / length, -turn * dx / length];
        let gap = |p: &Point32| (p[0] - from[0]) * nx + (p[1] - from[1]) * ny;
        widest = widest.max(b.iter().map(gap).fold(f32::INFINITY, f32::min));
    }
    widest
}

/// 1 for anticlockwise corners, else -1.
fn turning(a: &[Point32]) -> f32 {
    edges(a)
        .map(|(p, q)| (p[0] - a[0][0]) * (q[1] - a[0][1]) - (q[0] - a[0][0]) * (p[1] - a[0][1]))
        .sum::<f32>()
        .signum()
}

fn edges(a: &[Point32]) -> impl Iterator<Item = (Point32, Point32)> + '_ {
    a.iter().zip(a.iter().cycle().skip(1)).map(|(p, q)| (*p, *q))
}

fn squared_distance(a: &[Point32], b: &[Point32]) -> f32 {
    let one_way = |a: &[Point32], b: &[Point32]| {
        let mut least = f32::INFINITY;
        for point in a {
            for (from, to) in edges(b) {
                least = least.min(squared_distance_to_segment(*point, from, to));
            }
        }
        least
    };
    one_way(a, b).min(one_way(b, a))
}

fn squared_distance_to_segment(point: Point32, from: Point32, to: Point32) -> f32 {
    let [dx, dy] = [to[0] - from[0], to[1] - from[1]];
    let [px, py] = [point[0] - from[0], point[1] - from[1]];
    let along = ((px * dx + py * dy) / (dx * dx + dy * dy)).clamp(0.0, 1.0);
    let [ex, ey] = [px - along * dx, py - along * dy];
    ex * ex + ey * ey
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    const UNIT: [Point32; 4] = [[0.0, 0.0], [1.0, 0.0], [1.0, 1.0], [0.0, 1.0]];

    fn moved(dx: f32, dy: f32) -> [Point32; 4] {
        UNIT.map(|[x, y]| [x + dx, y + dy])
    }

    #[test]
    fn polygons_touch_within_their_skins() {
        assert!(touches(&UNIT, &moved(1.019, 0.0)));
        assert!(!touches(&UNIT, &moved(1.021, 0.0)));
        assert!(touches(&UNIT, &moved(0.2, 0.3)));
    }

    #[test]
    fn a_segment_is_a_polygon_of_two_corners() {
        let segment = |y: f32| [[-3.0, y], [4.0, y]];
        assert!(closer_than(&UNIT, &segment(0.5), 0.0));
        assert!(closer_than(&UNIT, &segment(1.1), 0.11) && !closer_than(&UNIT, &segment(1.1), 0.09));
        assert!(!closer_than(&UNIT, &[[1.2, 0.0], [4.0, 0.0]], 0.1));
    }

    #[test]
    fn corners_are_round() {
        // 0.018 off in both directions is 0.0255 away.
        assert!(!touches(&UNIT, &moved(1.018, 1.018)));
        assert!(touches(&UNIT, &moved(1.014, 1.014)));
    }

    proptest! {
        #[test]
        fn touching_is_symmetric_and_ignores_the_turning_direction(dx in -1.5f32..1.5, dy in -1.5f32..1.5) {
            let other = moved(dx, dy);
            let mut reversed = other;
            reversed.reverse();
            prop_assert_eq!(touches(&UNIT, &other), touches(&other, &UNIT));
            prop_assert_eq!(touches(&UNIT, &other), touches(&UNIT, &reversed));
        }
    }
}
