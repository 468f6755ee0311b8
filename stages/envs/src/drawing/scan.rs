//! Scan conversion: the columns that a convex polygon covers in each row of an image.

use std::ops::Range;

use super::surface::Point;

/// Fractional bits of a fixed-point column.
pub(super) const FRACTION: u32 = 32;
/// Half a pixel.
pub(super) const HALF: i64 = 1 << (FRACTION - 1);

/// A column coordinate with sub-pixel precision.
pub trait Column: Copy + Default {
    /// Writes where a straight edge crosses successive rows: `at` in the first, then `slope` farther in each.
    fn follow(crossings: &mut [Self], at: f64, slope: f64);
}

/// In fixed point.
impl Column for i64 {
    fn follow(crossings: &mut [Self], at: f64, slope: f64) {
        let (mut at, step) = (fixed(at), fixed(slope));
        for crossing in crossings {
            *crossing = at;
            at = at.wrapping_add(step);
        }
    }
}

impl Column for f32 {
    fn follow(crossings: &mut [Self], at: f64, slope: f64) {
        let (at, slope) = (at as f32, slope as f32);
        for (row, crossing) in crossings.iter_mut().enumerate() {
            *crossing = at + slope * row as u32 as f32;
        }
    }
}

/// Left and right edge of the current polygon, by row.
#[derive(Clone, Debug)]
pub struct Edges<C> {
    /// Left edge; only valid for the rows that [`Edges::trace`] returned.
    pub left: Vec<C>,
    /// Right edge.
    pub right: Vec<C>,
}

impl<C: Column> Edges<C> {
    /// Buffers for this many rows.
    pub fn new(rows: usize) -> Self {
        Self { left: vec![C::default(); rows], right: vec![C::default(); rows] }
    }

    /// Traces a convex polygon (in either orientation) through the rows above `floor`, and returns the rows that it covers
    /// in an image of `columns` columns.
    pub fn trace(&mut self, corners: &[Point], columns: usize, floor: usize) -> Range<usize> {
        let Some(last) = corners.last() else { return 0..0 };
        let (mut top, mut bottom) = (f64::INFINITY, f64::NEG_INFINITY);
        let (mut from, mut to) = (f64::INFINITY, f64::NEG_INFINITY);
        let (mut area, mut before) = (0.0, last);
        for corner in corners {
            (top, bottom) = (top.min(corner[1]), bottom.max(corner[1]));
            (from, to) = (from.min(corner[0]), to.max(corner[0]));
            area += before[0] * corner[1] - corner[0] * before[1];
            before = corner;
        }
        let rows = samples(top, bottom, floor.min(self.left.len()));
        if rows.is_empty() || to < -1.0 || from > columns as f64 + 1.0 {
            return 0..0;
        }
        // Clockwise on the screen, edges that run down are on the right.
        let mut before = last;
        for corner in corners {
            let down = before[1] < corner[1];
            let (upper, lower) = if down { (before, corner) } else { (corner, before) };
            let side = if down == (area > 0.0) { &mut self.right } else { &mut self.left };
            follow_edge(side, *upper, *lower, rows.end);
            before = corner;
        }
        rows
    }
}

/// Writes where an edge crosses the middle of each row.
fn follow_edge<C: Column>(side: &mut [C], upper: Point, lower: Point, floor: usize) {
    let rows = samples(upper[1], lower[1], floor);
    if rows.is_empty() {
        return;
    }
    let slope = (lower[0] - upper[0]) / (lower[1] - upper[1]);
    let at = upper[0] + (rows.start as f64 + 0.5 - upper[1]) * slope;
    C::follow(&mut side[rows], at, slope);
}

/// Converts to fixed point, saturating.
fn fixed(value: f64) -> i64 {
    (value * (1i64 << FRACTION) as f64) as i64
}

/// Indices below `limit` of the samples 0.5, 1.5, … in [from, to).
pub fn samples(from: f64, to: f64, limit: usize) -> Range<usize> {
    // A float cast truncates and saturates, and NaN becomes 0; `floor` and `ceil` would be function calls on older CPUs.
    let index = |at: f64| ((at + 0.5) as i32).max(0) as usize;
    let (from, to) = (index(from).min(limit), index(to).min(limit));
    from..to.max(from)
}
