//! Fills convex polygons, one sample at each pixel's centre.

/// A point of the picture: x to the right, y down, in pixels; the pixel at column c and row r has its sample at
/// (c + 0.5, r + 0.5).
pub type Dot = [f64; 2];

/// A picture with one byte per pixel.
#[derive(Clone, Debug)]
pub struct Canvas {
    width: usize,
    height: usize,
    pixels: Vec<u8>,
    spans: Vec<[f64; 2]>,
    sampling: Sampling,
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
        let (pixels, spans) = (vec![0; width * height], vec![[0.0; 2]; height]);
        Self { width, height, pixels, spans, sampling }
    }

    /// How far right of its pixels' centres a row is sampled.
    pub fn shift(&self, row: usize) -> f64 {
        self.sampling.shifts[row % 4]
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

    /// Fills the convex polygon in the rows above `floor`.
    pub fn fill(&mut self, corners: &[Dot], ink: u8, floor: usize) {
        let (mut top, mut bottom) = (f64::INFINITY, f64::NEG_INFINITY);
        let (mut left, mut right) = (f64::INFINITY, f64::NEG_INFINITY);
        for [x, y] in corners {
            (top, bottom) = (top.min(*y), bottom.max(*y));
            (left, right) = (left.min(*x), right.max(*x));
        }
        let rows = samples(top, bottom, floor.min(self.height));
        if rows.is_empty() || samples(left, right, self.width).is_empty() {
            return;
        }
        for span in &mut self.spans[rows.clone()] {
            *span = [f64::INFINITY, f64::NEG_INFINITY];
        }
        let last = corners.len() - 1;
        for (i, corner) in corners.iter().enumerate() {
            self.edge(corners[if i == 0 { last } else { i - 1 }], *corner, rows.end);
        }
        for row in rows {
            let ([from, to], shift) = (self.spans[row], self.shift(row));
            let columns =
                samples(from - shift - self.sampling.growth, to - shift + self.sampling.growth, self.width);
            if !columns.is_empty() {
                self.pixels[row * self.width + columns.start..row * self.width + columns.end].fill(ink);
            }
        }
    }

    /// Widens the spans of the rows that an edge crosses.
    fn edge(&mut self, p: Dot, q: Dot, floor: usize) {
        let (upper, lower) = if p[1] <= q[1] { (p, q) } else { (q, p) };
        let rows = samples(upper[1], lower[1], floor);
        if rows.is_empty() {
            return;
        }
        let slope = (lower[0] - upper[0]) / (lower[1] - upper[1]);
        let mut x = upper[0] + (rows.start as f64 + 0.5 - upper[1]) * slope;
        for span in &mut self.spans[rows] {
            *span = [span[0].min(x), span[1].max(x)];
            x += slope;
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

/// The samples 0.5, 1.5, .. in [from, to), as their indices below `limit`.
fn samples(from: f64, to: f64, limit: usize) -> std::ops::Range<usize> {
    // A cast of a float saturates, and NaN becomes 0.
    let index = |at: f64| ((at - 0.5).ceil() as usize).min(limit);
    let (from, to) = (index(from), index(to));
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

    proptest! {
        #[test]
        fn exactly_the_pixels_with_their_centre_inside_are_filled(
            centre in prop::array::uniform2(-5.0..25.0f64),
            radius in 0.1..15.0f64,
            turn in 0.0..6.3f64,
            n in 3usize..9,
        ) {
            let corner = |i: usize| {
                let angle = turn + i as f64 * std::f64::consts::TAU / n as f64;
                [centre[0] + radius * angle.cos(), centre[1] + radius * angle.sin()]
            };
            let corners: Vec<Dot> = (0..n).map(corner).collect();
            let mut canvas = Canvas::new(20, 16);
            canvas.fill(&corners, 1, 14);
            for row in 0..16 {
                for column in 0..20 {
                    let wanted = row < 14 && inside(&corners, [column as f64 + 0.5, row as f64 + 0.5]);
                    prop_assert_eq!(canvas.pixels()[row * 20 + column] == 1, wanted, "{}, {}", row, column);
                }
            }
        }
    }

    #[test]
    fn polygons_off_the_picture_and_numbers_that_are_none_draw_nothing() {
        let mut canvas = Canvas::new(4, 4);
        canvas.fill(&[[9.0, 1.0], [12.0, 1.0], [12.0, 3.0]], 1, 4);
        canvas.fill(&[[f64::NAN, 1.0], [2.0, f64::NAN], [1.0, 3.0]], 1, 4);
        canvas.fill(&[[-1e300, -5.0], [1e300, -5.0], [0.0, -2.0]], 1, 4);
        assert_eq!(canvas.pixels(), [0; 16]);
    }
}
