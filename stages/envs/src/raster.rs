//! Convex polygons, from their corners to the columns that they cover in each row; and the plain picture that samples
//! them once per pixel.

use std::ops::Range;

use crate::surface::Surface;

/// A point of the picture: x to the right, y down, in pixels; the pixel at column c and row r has its centre at
/// (c + 0.5, r + 0.5).
pub type Dot = [f64; 2];

/// Fractional bits of a column that is a whole number.
const FRACTION: u32 = 32;
/// Half a pixel.
const HALF: i64 = 1 << (FRACTION - 1);

/// A column, to a fraction of a pixel.
pub trait Column: Copy + Default {
    /// Notes where a straight edge crosses one row after the other: `at` in the first, then `slope` farther in each.
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

/// Where the polygon at hand begins and ends, by row.
#[derive(Clone, Debug)]
pub struct Edges<C> {
    /// Where it begins; only the rows that [`Edges::trace`] gave mean something.
    pub left: Vec<C>,
    /// Where it ends.
    pub right: Vec<C>,
}

impl<C: Column> Edges<C> {
    /// Room for so many rows.
    pub fn new(rows: usize) -> Self {
        Self { left: vec![C::default(); rows], right: vec![C::default(); rows] }
    }

    /// Follows a convex polygon (corners in either turning direction) through the rows above `floor`; gives the rows
    /// that it covers in a picture of so many columns.
    pub fn trace(&mut self, corners: &[Dot], columns: usize, floor: usize) -> Range<usize> {
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

/// A picture with one byte per pixel, sampled in the pixels' centres.
#[derive(Clone, Debug)]
pub struct Canvas {
    width: usize,
    height: usize,
    pixels: Vec<u8>,
    edges: Edges<i64>,
}

impl Canvas {
    /// A picture of zeros.
    pub fn new(width: usize, height: usize) -> Self {
        Self { width, height, pixels: vec![0; width * height], edges: Edges::new(height) }
    }

    /// Row-major, row 0 on top.
    pub fn pixels(&self) -> &[u8] {
        &self.pixels
    }

    /// The same, to draw over.
    pub fn pixels_mut(&mut self) -> &mut [u8] {
        &mut self.pixels
    }
}

impl Surface for Canvas {
    // A sample is covered or not: there are no seams.
    const MOSAIC_FROM_FRONT: bool = false;

    fn begin_mosaic(&mut self) {}

    fn end_mosaic(&mut self, _floor: usize) {}

    fn size(&self) -> [usize; 2] {
        [self.width, self.height]
    }

    fn clear(&mut self, ink: u8, floor: usize) {
        let end = floor.min(self.height) * self.width;
        self.pixels[..end].fill(ink);
    }

    fn fill(&mut self, corners: &[Dot], ink: u8, floor: usize) {
        let rows = self.edges.trace(corners, self.width, floor);
        let width = self.width as i64;
        let lines = self.pixels[rows.start * self.width..].chunks_exact_mut(self.width.max(1));
        let spans = self.edges.left[rows.clone()].iter().zip(&self.edges.right[rows]);
        for (line, (left, right)) in lines.zip(spans) {
            let column = |at: i64| (at.saturating_add(HALF) >> FRACTION).clamp(0, width) as usize;
            if let Some(span) = line.get_mut(column(*left)..column(*right)) {
                span.fill(ink);
            }
        }
    }

    fn fill_box(&mut self, [x0, y0]: Dot, [x1, y1]: Dot, ink: u8) {
        let columns = samples(x0.min(x1), x0.max(x1), self.width);
        for row in samples(y0.min(y1), y0.max(y1), self.height) {
            self.pixels[row * self.width..][columns.clone()].fill(ink);
        }
    }
}

/// Notes where an edge crosses the middle of each row.
fn follow_edge<C: Column>(side: &mut [C], upper: Dot, lower: Dot, floor: usize) {
    let rows = samples(upper[1], lower[1], floor);
    if rows.is_empty() {
        return;
    }
    let slope = (lower[0] - upper[0]) / (lower[1] - upper[1]);
    let at = upper[0] + (rows.start as f64 + 0.5 - upper[1]) * slope;
    C::follow(&mut side[rows], at, slope);
}

/// In fixed point; far outside values stop at the ends.
fn fixed(value: f64) -> i64 {
    (value * (1i64 << FRACTION) as f64) as i64
}

/// The samples 0.5, 1.5, .. in [from, to), as their indices below `limit`.
pub fn samples(from: f64, to: f64, limit: usize) -> Range<usize> {
    // A cast of a float cuts off and saturates, and NaN becomes 0; `floor` and `ceil` would be calls on older machines.
    let index = |at: f64| ((at + 0.5) as i32).max(0) as usize;
    let (from, to) = (index(from).min(limit), index(to).min(limit));
    from..to.max(from)
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn inside(corners: &[Dot], [x, y]: Dot) -> bool {
        let side = |(p, q): (&Dot, &Dot)| (q[0] - p[0]) * (y - p[1]) - (q[1] - p[1]) * (x - p[0]);
        let sides: Vec<f64> = corners.iter().zip(corners.iter().cycle().skip(1)).map(side).collect();
        sides.iter().all(|s| *s > 0.0) || sides.iter().all(|s| *s < 0.0)
    }

    fn polygon(centre: Dot, radius: f64, turn: f64, n: usize, reversed: bool) -> Vec<Dot> {
        let corner = |i: usize| {
            let angle = turn + i as f64 * std::f64::consts::TAU / n as f64;
            [centre[0] + radius * angle.cos(), centre[1] + radius * angle.sin()]
        };
        let mut corners: Vec<Dot> = (0..n).map(corner).collect();
        if reversed {
            corners.reverse();
        }
        corners
    }

    proptest! {
        #[test]
        fn exactly_the_pixels_with_their_sample_inside_are_filled(
            centre in prop::array::uniform2(-5.0..25.0f64),
            radius in 0.1..15.0f64,
            turn in 0.0..6.3f64,
            n in 3usize..9,
            reversed: bool,
        ) {
            let corners = polygon(centre, radius, turn, n, reversed);
            let mut canvas = Canvas::new(20, 16);
            canvas.fill(&corners, 1, 14);
            for row in 0..16 {
                for column in 0..20 {
                    let sample = [column as f64 + 0.5, row as f64 + 0.5];
                    let wanted = row < 14 && inside(&corners, sample);
                    prop_assert_eq!(canvas.pixels()[row * 20 + column] == 1, wanted, "{}, {}", row, column);
                }
            }
        }
    }

    #[test]
    fn polygons_off_the_picture_and_numbers_that_are_none_draw_nothing() {
        let mut canvas = Canvas::new(4, 4);
        canvas.fill(&[[9.0, 1.0], [12.0, 1.0], [12.0, 3.0]], 1, 4);
        canvas.fill(&[[-1e300, -5.0], [1e300, -5.0], [0.0, -2.0]], 1, 4);
        canvas.fill(&[], 1, 4);
        assert_eq!(canvas.pixels(), [0; 16]);
        // Whatever they draw, they must not panic.
        canvas.fill(&[[f64::NAN, 1.0], [2.0, f64::NAN], [1.0, 3.0]], 1, 4);
        canvas.fill(&[[1e300, -1e300], [1e300, 1e300], [-1e300, f64::INFINITY]], 1, 4);
    }
}
