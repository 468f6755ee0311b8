//! An image with one sample per pixel: each pixel has the ink of the last polygon that covers its centre.

use super::scan::{Edges, FRACTION, HALF, samples};
use super::surface::{Point, Surface};

/// An image with one byte per pixel, sampled in the pixels' centres.
#[derive(Clone, Debug)]
pub struct Canvas {
    width: usize,
    height: usize,
    pixels: Vec<u8>,
    edges: Edges<i64>,
}

impl Canvas {
    /// An image of zeros.
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

    fn fill(&mut self, corners: &[Point], ink: u8, floor: usize) {
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

    fn fill_box(&mut self, [x0, y0]: Point, [x1, y1]: Point, ink: u8) {
        let columns = samples(x0.min(x1), x0.max(x1), self.width);
        for row in samples(y0.min(y1), y0.max(y1), self.height) {
            self.pixels[row * self.width..][columns.clone()].fill(ink);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn inside(corners: &[Point], [x, y]: Point) -> bool {
        let side = |(p, q): (&Point, &Point)| (q[0] - p[0]) * (y - p[1]) - (q[1] - p[1]) * (x - p[0]);
        let sides: Vec<f64> = corners.iter().zip(corners.iter().cycle().skip(1)).map(side).collect();
        sides.iter().all(|s| *s > 0.0) || sides.iter().all(|s| *s < 0.0)
    }

    fn polygon(centre: Point, radius: f64, turn: f64, n: usize, reversed: bool) -> Vec<Point> {
        let corner = |i: usize| {
            let angle = turn + i as f64 * std::f64::consts::TAU / n as f64;
            [centre[0] + radius * angle.cos(), centre[1] + radius * angle.sin()]
        };
        let mut corners: Vec<Point> = (0..n).map(corner).collect();
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
    fn polygons_off_the_image_and_numbers_that_are_none_draw_nothing() {
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
