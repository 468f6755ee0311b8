//! Anti-aliased convex polygons, by area coverage.
//!
//! Each row of pixels is divided into [`LINES`] lines. Along a line, a polygon's coverage of each pixel is exact; the pixel
//! is then blended from its old level and the polygon's ink. No samples are stored, and only pixels on an outline need
//! arithmetic: single `f32` operations in a fixed order, which every processor rounds the same way.
//!
//! Blended one after the other, two polygons that share an edge would let the background show through the seam. The
//! polygons of a mosaic are therefore accumulated separately, front to back: each gets the part of a pixel that those
//! before it have left.

use std::ops::Range;

use super::scan::{Edges, samples};
use super::surface::{Point, Surface};

/// Lines per row of pixels.
pub const LINES: usize = 4;
/// The weight of full coverage.
const WHOLE: i32 = 256;

/// An image of one or several channels.
#[derive(Clone, Debug)]
pub struct AreaCanvas {
    width: usize,
    height: usize,
    /// Pixels by which polygons are widened on both sides.
    growth: f32,
    edges: Edges<f32>,
    channels: Vec<Channel>,
    /// True inside a mosaic.
    in_mosaic: bool,
    /// Coverage of each pixel by the mosaic, of [`WHOLE`].
    covers: Vec<u16>,
    /// Coverage of the current row by the current polygon, in the same units.
    weights: Vec<u16>,
}

#[derive(Clone, Debug)]
struct Channel {
    /// Level of each ink.
    levels: Vec<u8>,
    pixels: Vec<u8>,
    /// Weighted sum of the mosaic's levels.
    light: Vec<u16>,
}

impl Channel {
    fn level(&self, ink: u8) -> u8 {
        self.levels.get(usize::from(ink)).copied().unwrap_or(0)
    }
}

/// The part of a pixel row that a polygon covers: start and end of each line, in pixels.
#[derive(Clone, Copy, Debug)]
struct Strip {
    from: [f32; LINES],
    to: [f32; LINES],
}

impl AreaCanvas {
    /// An image of `width` x `height` pixels in which polygons are `growth` pixels wider on both sides; `levels` are the
    /// channels of every ink.
    pub fn new<const N: usize>(width: usize, height: usize, growth: f64, levels: &[[u8; N]]) -> Self {
        let channel = |channel: usize| Channel {
            levels: levels.iter().map(|ink| ink[channel]).collect(),
            pixels: vec![0; width * height],
            light: vec![0; width * height],
        };
        Self {
            width,
            height,
            growth: growth as f32,
            edges: Edges::new(height * LINES),
            channels: (0..N).map(channel).collect(),
            in_mosaic: false,
            covers: vec![0; width * height],
            weights: vec![0; width],
        }
    }

    /// The pixels of one channel, row-major, row 0 on top; empty if there is no such channel.
    pub fn channel(&self, channel: usize) -> &[u8] {
        self.channels.get(channel).map_or(&[], |channel| &channel.pixels)
    }

    /// The same, mutable.
    pub fn channel_mut(&mut self, channel: usize) -> &mut [u8] {
        self.channels.get_mut(channel).map_or(&mut [], |channel| &mut channel.pixels)
    }

    /// Writes the image with interleaved channels.
    pub fn interleave(&self, to: &mut [u8]) {
        for (at, channel) in self.channels.iter().enumerate() {
            let places = to.iter_mut().skip(at).step_by(self.channels.len());
            places.zip(&channel.pixels).for_each(|(to, level)| *to = *level);
        }
    }

    /// Paints the traced polygon on these lines.
    fn paint(&mut self, lines: Range<usize>, growth: f32, ink: u8) {
        let rows = lines.start / LINES..lines.end.div_ceil(LINES);
        // Uncovered lines of the first and last row are marked as empty: they start after they end.
        for line in (rows.start * LINES..lines.start).chain(lines.end..rows.end * LINES) {
            (self.edges.left[line], self.edges.right[line]) = (f32::INFINITY, f32::NEG_INFINITY);
        }
        let width = self.width as f32;
        let [left, right] = [&self.edges.left, &self.edges.right].map(|side| side.as_chunks::<LINES>().0);
        for row in rows {
            let strip = Strip {
                from: left[row].map(|x| larger(x - growth, 0.0)),
                to: right[row].map(|x| smaller(x + growth, width)),
            };
            let pixels = row * self.width..(row + 1) * self.width;
            let Some(columns) = strip.columns(self.width) else { continue };
            if self.in_mosaic {
                let all = pixels.start + columns.all.start..pixels.start + columns.all.end;
                let (covers, weights) =
                    (&mut self.covers[all.clone()], &mut self.weights[columns.all.clone()]);
                strip.weigh(&columns, covers, weights);
                for channel in &mut self.channels {
                    let level = u16::from(channel.level(ink));
                    for (light, weight) in channel.light[all.clone()].iter_mut().zip(&*weights) {
                        *light += weight * level;
                    }
                }
            } else {
                for channel in &mut self.channels {
                    let level = channel.level(ink);
                    strip.paint(&columns, &mut channel.pixels[pixels.clone()], level);
                }
            }
        }
    }
}

/// Columns of a row that a strip touches.
struct Columns {
    all: Range<usize>,
    /// Fully covered columns; `all.end..all.end` if there are none.
    whole: Range<usize>,
}

impl Strip {
    /// The columns that it touches in a row of `width`, if any.
    fn columns(&self, width: usize) -> Option<Columns> {
        let (from, to) = (reduce(self.from, smaller), reduce(self.to, larger));
        if from >= to {
            return None;
        }
        // Columns are small: a cast to `i32` is one to `usize`, and takes fewer instructions.
        let column = |x: f32| x as i32 as usize;
        let (first, end) = (column(from), (column(to) + 1).min(width));
        // Columns between the innermost ends are fully covered.
        let (inner_from, inner_to) = (reduce(self.from, larger), reduce(self.to, smaller));
        let whole = if inner_from < inner_to { column(inner_from) + 1..column(inner_to) } else { end..end };
        Some(Columns { all: first..end, whole: if whole.is_empty() { end..end } else { whole } })
    }

    /// Blends the level into a row of pixels.
    fn paint(&self, Columns { all, whole }: &Columns, pixels: &mut [u8], level: u8) {
        for columns in [all.start..whole.start, whole.end..all.end] {
            for (pixel, column) in pixels[columns.clone()].iter_mut().zip(columns) {
                let weight = self.weight(column);
                // Also keeps the compiler from working on many pixels at once, of which there are two or three.
                if weight > 0 {
                    let before = i32::from(*pixel);
                    *pixel = (before + (((i32::from(level) - before) * weight + WHOLE / 2) >> WHOLE.ilog2()))
                        as u8;
                }
            }
        }
        pixels[whole.clone()].fill(level);
    }

    /// Computes the weight of each column, limited by the coverage that is left, and adds it to the coverage.
    fn weigh(&self, Columns { all, whole }: &Columns, covers: &mut [u16], weights: &mut [u16]) {
        for columns in [all.start..whole.start, whole.end..all.end] {
            let places = &mut weights[columns.start - all.start..columns.end - all.start];
            for (place, column) in places.iter_mut().zip(columns) {
                let weight = self.weight(column);
                *place = 0;
                if weight > 0 {
                    *place = weight as u16;
                }
            }
        }
        weights[whole.start - all.start..whole.end - all.start].fill(WHOLE as u16);
        for (cover, weight) in covers.iter_mut().zip(weights) {
            *weight = (*weight).min(WHOLE as u16 - *cover);
            *cover += *weight;
        }
    }

    /// Coverage of the pixel at this column, of [`WHOLE`].
    fn weight(&self, column: usize) -> i32 {
        let left = column as u32 as f32;
        let cover: [f32; LINES] = std::array::from_fn(|line| {
            larger(smaller(self.to[line], left + 1.0) - larger(self.from[line], left), 0.0)
        });
        (reduce(cover, |a, b| a + b) * (WHOLE as f32 / LINES as f32) + 0.5) as i32
    }
}

/// Pairs first, as vector instructions do.
fn reduce([a, b, c, d]: [f32; LINES], with: impl Fn(f32, f32) -> f32) -> f32 {
    with(with(a, c), with(b, d))
}

/// The smaller one; `b` if unordered. The processor's instruction, unlike `f32::min`, behaves this way.
fn smaller(a: f32, b: f32) -> f32 {
    if a < b { a } else { b }
}

/// The larger one; `b` if unordered.
fn larger(a: f32, b: f32) -> f32 {
    if a > b { a } else { b }
}

impl Surface for AreaCanvas {
    const MOSAIC_FROM_FRONT: bool = true;

    fn begin_mosaic(&mut self) {
        self.in_mosaic = true;
    }

    fn end_mosaic(&mut self, floor: usize) {
        self.in_mosaic = false;
        let end = floor.div_ceil(LINES).min(self.height) * self.width;
        for Channel { pixels, light, .. } in &mut self.channels {
            for ((pixel, light), cover) in pixels[..end].iter_mut().zip(light).zip(&self.covers) {
                let below = u16::from(*pixel) * (WHOLE as u16 - cover);
                *pixel = ((below + *light + WHOLE as u16 / 2) >> WHOLE.ilog2()) as u8;
                *light = 0;
            }
        }
        self.covers[..end].fill(0);
    }

    fn size(&self) -> [usize; 2] {
        [self.width, self.height * LINES]
    }

    fn clear(&mut self, ink: u8, floor: usize) {
        let end = (floor / LINES).min(self.height) * self.width;
        for channel in &mut self.channels {
            let level = channel.level(ink);
            channel.pixels[..end].fill(level);
        }
    }

    fn fill(&mut self, corners: &[Point], ink: u8, floor: usize) {
        let lines = self.edges.trace(corners, self.width, floor);
        self.paint(lines, self.growth, ink);
    }

    fn fill_box(&mut self, [x0, y0]: Point, [x1, y1]: Point, ink: u8) {
        let lines = samples(y0.min(y1), y0.max(y1), self.height * LINES);
        self.edges.left[lines.clone()].fill(x0.min(x1) as f32);
        self.edges.right[lines.clone()].fill(x0.max(x1) as f32);
        self.paint(lines, 0.0, ink);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::drawing::canvas::Canvas;
    use proptest::prelude::*;

    const SIZE: [usize; 2] = [12, 6];
    const LEVELS: [[u8; 2]; 2] = [[20, 255], [220, 10]];

    /// The mean of many samples on every line.
    fn finely_sampled(polygon: &[Point], floor: usize) -> Vec<u8> {
        /// Samples per pixel of a line.
        const FINE: usize = 512;
        let [width, height] = SIZE;
        let mut canvas = Canvas::new(width * FINE, height * LINES);
        let stretched: Vec<Point> = polygon.iter().map(|[x, y]| [x * FINE as f64, *y]).collect();
        canvas.fill(&stretched, 1, floor);
        let cover = |row: usize, column: usize| {
            let lines = row * LINES..(row + 1) * LINES;
            let samples = lines.flat_map(|line| &canvas.pixels()[(line * width + column) * FINE..][..FINE]);
            samples.filter(|ink| **ink == 1).count() as f64 / (FINE * LINES) as f64
        };
        let mixed = |cover: f64, channel: usize| {
            let [ground, ink] = LEVELS.map(|levels| f64::from(levels[channel]));
            (ground + cover * (ink - ground)).round() as u8
        };
        let pixels = (0..height).flat_map(|row| (0..width).map(move |column| (row, column)));
        pixels.flat_map(|(row, column)| [0, 1].map(|channel| mixed(cover(row, column), channel))).collect()
    }

    prop_compose! {
        /// A convex polygon, part of it off the image at times.
        fn polygon()(
            centre in prop::array::uniform2(-2.0..26.0f64), radius in 0.2..14.0f64, turn in 0.0..6.3f64, n in 3usize..9,
        ) -> Vec<Point> {
            let corner = |i: usize| {
                let angle = turn + i as f64 * std::f64::consts::TAU / n as f64;
                [centre[0] / 2.0 + radius * angle.cos() / 2.0, centre[1] + radius * angle.sin()]
            };
            (0..n).map(corner).collect()
        }
    }

    proptest! {
        #[test]
        fn a_pixel_is_mixed_by_how_much_of_its_lines_is_covered(
            polygon in polygon(),
            floor in 0..=SIZE[1] * LINES,
        ) {
            let [width, height] = SIZE;
            let mut canvas = AreaCanvas::new(width, height, 0.0, &LEVELS);
            canvas.clear(0, height * LINES);
            canvas.fill(&polygon, 1, floor);
            let mut seen = vec![0; width * height * 2];
            canvas.interleave(&mut seen);
            for (at, (seen, wanted)) in seen.iter().zip(&finely_sampled(&polygon, floor)).enumerate() {
                // A weight is one of 256.
                prop_assert!(seen.abs_diff(*wanted) <= 1, "value {}: {} for {}", at, seen, wanted);
            }
        }
    }

    #[test]
    fn boxes_cover_parts_of_pixels_and_later_ink_hides_earlier_ink() {
        let mut canvas = AreaCanvas::new(4, 2, 0.0, &[[0], [200]]);
        canvas.fill_box([0.0, 0.0], [4.0, 8.0], 1);
        canvas.fill_box([0.5, 0.0], [2.25, 2.0], 0);
        assert_eq!(canvas.channel(0), [150, 100, 175, 200, 200, 200, 200, 200]);
        canvas.clear(1, 4);
        assert_eq!(canvas.channel(0), [200; 8]);
    }

    #[test]
    fn pieces_of_a_mosaic_leave_no_seam_and_the_first_ones_hide_the_others() {
        let mut canvas = AreaCanvas::new(4, 2, 0.0, &[[0], [200], [100]]);
        canvas.begin_mosaic();
        // Two quadrilaterals that share a slanting edge, over a third one that sticks out below them.
        canvas.fill(&[[0.0, 0.0], [1.3, 0.0], [2.6, 4.0], [0.0, 4.0]], 1, 8);
        canvas.fill(&[[1.3, 0.0], [4.0, 0.0], [4.0, 4.0], [2.6, 4.0]], 1, 8);
        canvas.fill(&[[1.0, 0.0], [2.5, 0.0], [2.5, 8.0], [1.0, 8.0]], 2, 8);
        canvas.end_mosaic(8);
        assert_eq!(canvas.channel(0), [200, 200, 200, 200, 0, 100, 50, 0]);
        canvas.begin_mosaic();
        canvas.end_mosaic(8);
        assert_eq!(canvas.channel(0), [200, 200, 200, 200, 0, 100, 50, 0]);
    }

    #[test]
    fn growth_widens_to_both_sides() {
        let mut canvas = AreaCanvas::new(4, 1, 0.25, &[[0], [100]]);
        canvas.fill(&[[1.0, 0.0], [2.0, 0.0], [2.0, 4.0], [1.0, 4.0]], 1, 4);
        assert_eq!(canvas.channel(0), [25, 100, 25, 0]);
    }

    #[test]
    fn polygons_off_the_image_and_numbers_that_are_none_do_not_panic() {
        let mut canvas = AreaCanvas::new(4, 1, 0.05, &[[0], [100]]);
        canvas.fill(&[[9.0, 1.0], [12.0, 1.0], [12.0, 3.0]], 1, 4);
        canvas.fill(&[[-1e300, -5.0], [1e300, -5.0], [0.0, -2.0]], 1, 4);
        canvas.fill(&[], 1, 4);
        canvas.fill_box([5.0, 0.0], [9.0, 4.0], 1);
        assert_eq!(canvas.channel(0), [0; 4]);
        // Whatever these draw.
        canvas.fill(&[[f64::NAN, 1.0], [2.0, f64::NAN], [1.0, 3.0]], 1, 4);
        canvas.fill(&[[1e300, -1e300], [1e300, 1e300], [-1e300, f64::INFINITY]], 1, 4);
        canvas.fill_box([f64::NAN, 0.0], [f64::INFINITY, 1e300], 1);
        canvas.fill_box([0.0, 0.0], [1.0, 1.0], 9);
    }
}
