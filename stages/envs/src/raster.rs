//! Fills convex polygons, one sample per pixel.

use std::ops::Range;

/// A point of the picture: x to the right, y down, in pixels; the pixel at column c and row r has its centre at
/// (c + 0.5, r + 0.5).
pub type Dot = [f64; 2];

/// Fractional bits of a column while an edge is followed from row to row.
const BITS: u32 = 32;

/// A picture with one byte per pixel.
#[derive(Clone, Debug)]
pub struct Canvas {
    width: usize,
    height: usize,
    pixels: Vec<u8>,
    /// Where the polygon at hand begins and ends, by row, in fixed point.
    left: Vec<i64>,
    right: Vec<i64>,
    /// What is added to both before their whole part is the first column and the one after the last, by row modulo 4.
    rounding: [[i64; 2]; 4],
}

/// Where a canvas looks at what it fills.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Sampling {
    /// How far right of the pixel's centre the sample is, in pixels, by row modulo 4.
    pub shifts: [f64; 4],
    /// By how much polygons are widened to both sides, in pixels.
    pub growth: f64,
}

impl Canvas {
    /// A picture of zeros.
    pub fn new(width: usize, height: usize) -> Self {
        Self::with_sampling(width, height, Sampling::default())
    }

    /// A picture of zeros, sampled elsewhere than at its pixels' centres.
    pub fn with_sampling(width: usize, height: usize, sampling: Sampling) -> Self {
        let rounding = sampling.shifts.map(|shift| {
            let middle = 0.5 - shift;
            [fixed(middle - sampling.growth), fixed(middle + sampling.growth)]
        });
        let (left, right) = (vec![0; height], vec![0; height]);
        Self { width, height, pixels: vec![0; width * height], left, right, rounding }
    }

    /// Columns.
    pub fn width(&self) -> usize {
        self.width
    }

    /// Rows.
    pub fn height(&self) -> usize {
        self.height
    }

    /// Row-major, row 0 on top.
    pub fn pixels(&self) -> &[u8] {
        &self.pixels
    }

    /// Pixels of one row.
    pub fn row_mut(&mut self, row: usize) -> &mut [u8] {
        &mut self.pixels[row * self.width..(row + 1) * self.width]
    }

    /// Fills the convex polygon (corners in either turning direction) in the rows above `floor`.
    pub fn fill(&mut self, corners: &[Dot], ink: u8, floor: usize) {
        let Some(last) = corners.last() else { return };
        let (mut top, mut bottom) = (f64::INFINITY, f64::NEG_INFINITY);
        let (mut from, mut to) = (f64::INFINITY, f64::NEG_INFINITY);
        let (mut area, mut before) = (0.0, last);
        for corner in corners {
            (top, bottom) = (top.min(corner[1]), bottom.max(corner[1]));
            (from, to) = (from.min(corner[0]), to.max(corner[0]));
            area += before[0] * corner[1] - corner[0] * before[1];
            before = corner;
        }
        let rows = samples(top, bottom, floor.min(self.height));
        if rows.is_empty() || to < -1.0 || from > self.width as f64 + 1.0 {
            return;
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
        self.fill_rows(rows, ink);
    }

    fn fill_rows(&mut self, rows: Range<usize>, ink: u8) {
        let width = self.width as i64;
        let lines = self.pixels[rows.start * self.width..].chunks_exact_mut(self.width.max(1));
        let spans = self.left[rows.clone()].iter().zip(&self.right[rows.clone()]);
        for ((line, (left, right)), row) in lines.zip(spans).zip(rows) {
            let [first, end] = self.rounding[row % 4];
            let column = |at: i64| (at >> BITS).clamp(0, width) as usize;
            let (first, end) = (column(left.saturating_add(first)), column(right.saturating_add(end)));
            if let Some(span) = line.get_mut(first..end) {
                span.fill(ink);
            }
        }
    }

    /// Fills the axis-parallel rectangle between two corners.
    pub fn fill_box(&mut self, [x0, y0]: Dot, [x1, y1]: Dot, ink: u8) {
        let columns = samples(x0.min(x1), x0.max(x1), self.width);
        for row in samples(y0.min(y1), y0.max(y1), self.height) {
            self.row_mut(row)[columns.clone()].fill(ink);
        }
    }
}

/// Averages squares of `samples` x `samples` into `to`, row-major; `look_up` gives the channels of a sample, `loss` is
/// taken off every level.
pub fn average<const N: usize>(
    canvas: &Canvas,
    samples: usize,
    loss: u8,
    look_up: impl Fn(u8) -> [u8; N],
    to: &mut [u8],
) {
    let columns = canvas.width() / samples;
    for (at, pixel) in to.chunks_exact_mut(N).enumerate() {
        let (row, column) = (at / columns, at % columns);
        let mut sums = [0u32; N];
        for line in row * samples..(row + 1) * samples {
            let from = line * canvas.width() + column * samples;
            for ink in &canvas.pixels()[from..from + samples] {
                for (sum, level) in sums.iter_mut().zip(look_up(*ink)) {
                    *sum += u32::from(level);
                }
            }
        }
        for (level, sum) in pixel.iter_mut().zip(sums) {
            *level = ((sum / (samples * samples) as u32) as u8).saturating_sub(loss);
        }
    }
}

/// Notes where an edge crosses the middle of each row.
fn follow_edge(side: &mut [i64], upper: Dot, lower: Dot, floor: usize) {
    let rows = samples(upper[1], lower[1], floor);
    if rows.is_empty() {
        return;
    }
    let slope = (lower[0] - upper[0]) / (lower[1] - upper[1]);
    let mut at = fixed(upper[0] + (rows.start as f64 + 0.5 - upper[1]) * slope);
    let step = fixed(slope);
    for crossing in &mut side[rows] {
        *crossing = at;
        at = at.wrapping_add(step);
    }
}

/// In fixed point; far outside values stop at the ends.
fn fixed(value: f64) -> i64 {
    (value * (1i64 << BITS) as f64) as i64
}

/// The samples 0.5, 1.5, .. in [from, to), as their indices below `limit`.
fn samples(from: f64, to: f64, limit: usize) -> Range<usize> {
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
            shifts in prop::array::uniform4(-0.4..0.4f64),
        ) {
            let corners = polygon(centre, radius, turn, n, reversed);
            let mut canvas = Canvas::with_sampling(20, 16, Sampling { shifts, growth: 0.0 });
            canvas.fill(&corners, 1, 14);
            for row in 0..16 {
                for column in 0..20 {
                    let sample = [column as f64 + 0.5 + shifts[row % 4], row as f64 + 0.5];
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
