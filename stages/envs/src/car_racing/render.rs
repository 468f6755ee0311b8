//! Draws a scene as gym's CarRacing-v0 or as Gymnasium's CarRacing-v3.
//!
//! Version 0 draws plain polygons with one sample per pixel, and its view follows the velocity. Version 3 draws a window
//! of 1000 x 800 and shrinks it by area averaging, and its view follows the hull; here 4 x 4 samples per pixel stand for
//! the window's 87.

use super::camera::{Camera, WINDOW};
use super::indicators;
use super::paint::Painter;
use super::palette::{self, Inks};
use super::scene::Scene;
use super::text::Text;
use super::track::Track;
use crate::CarRacingVersion;
use crate::raster::{Canvas, Sampling, average};

/// Rows of the bar in eighths of the picture.
const BAR: usize = 8;
/// Samples per pixel and axis where a picture is averaged.
pub const SAMPLES: usize = 4;
/// Rows of samples are shifted against each other, so that upright edges fall on 16 levels instead of 4.
const SHIFTS: [f64; 4] = [-0.375, 0.125, -0.125, 0.375];
/// The later version fills polygons up to and with the pixels on their edge: half a window pixel more on each side.
const GROWTH: f64 = 0.5;
/// Levels that the later version's shrinking loses: one in each of its two passes.
const SHRINK_LOSS: u8 = 2;

/// Grey levels or colours?
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Output {
    /// One byte per pixel.
    Grey,
    /// Red, green and blue per pixel.
    Rgb,
}

/// A picture and how to draw it. Nothing is allocated after [`Renderer::new`].
#[derive(Clone, Debug)]
pub struct Renderer {
    version: CarRacingVersion,
    output: Output,
    samples: usize,
    canvas: Canvas,
    inks: Inks,
    colours: [[u8; 3]; palette::COUNT],
    text: Text,
    pixels: Vec<u8>,
    sums: Vec<u16>,
}

impl Renderer {
    /// Pictures as the original observes them, `width` x `height`.
    pub fn new(version: CarRacingVersion, output: Output, [width, height]: [usize; 2]) -> Self {
        let samples = match version {
            CarRacingVersion::V0 => 1,
            CarRacingVersion::V3 => SAMPLES,
        };
        Self::with_samples(version, output, [width, height], samples)
    }

    /// Pictures with `samples` x `samples` samples per pixel.
    pub fn with_samples(
        version: CarRacingVersion,
        output: Output,
        [width, height]: [usize; 2],
        samples: usize,
    ) -> Self {
        let samples = samples.max(1);
        let window_pixel = (width * samples) as f64 / WINDOW[0];
        let sampling = Sampling {
            shifts: if samples == 1 { [0.0; 4] } else { SHIFTS },
            growth: if version == CarRacingVersion::V3 { GROWTH * window_pixel } else { 0.0 },
        };
        let (colours, channels) = (palette::rgb(version), if output == Output::Grey { 1 } else { 3 });
        Self {
            version,
            output,
            samples,
            canvas: Canvas::with_sampling(width * samples, height * samples, sampling),
            inks: if output == Output::Grey { Inks::grey(&colours) } else { Inks::indices() },
            colours,
            text: Text::new(version, width * samples, height * samples),
            pixels: vec![0; width * height * channels],
            sums: vec![0; width * samples],
        }
    }

    /// The last picture drawn, row-major, row 0 on top.
    pub fn pixels(&self) -> &[u8] {
        if self.is_direct() { self.canvas.pixels() } else { &self.pixels }
    }

    /// Draws the scene.
    pub fn draw(&mut self, track: &Track, scene: &Scene<'_>) {
        let size = [self.canvas.width(), self.canvas.height()];
        let camera = match self.version {
            CarRacingVersion::V0 => Camera::following_velocity(scene, size),
            CarRacingVersion::V3 => Camera::following_hull(scene, size),
        };
        let floor = size[1] - size[1] / BAR;
        let mut painter = Painter { canvas: &mut self.canvas, camera, inks: &self.inks, floor };
        painter.grass();
        painter.road(track, scene);
        painter.car(scene);
        indicators::draw(&mut self.canvas, scene, &self.inks, self.version);
        self.text.draw(&mut self.canvas, scene.score, &self.inks);
        if !self.is_direct() {
            self.develop();
        }
    }

    /// True where the canvas is the picture.
    fn is_direct(&self) -> bool {
        self.output == Output::Grey && self.samples == 1
    }

    /// Averages the canvas into the picture.
    fn develop(&mut self) {
        let loss = if self.version == CarRacingVersion::V3 { SHRINK_LOSS } else { 0 };
        match (self.output, self.samples) {
            (Output::Grey, SAMPLES) => shrink_grey(&self.canvas, loss, &mut self.sums, &mut self.pixels),
            (Output::Grey, samples) => average(&self.canvas, samples, loss, |ink| [ink], &mut self.pixels),
            (Output::Rgb, samples) => {
                let colours = &self.colours;
                average(&self.canvas, samples, loss, |ink| colours[ink as usize], &mut self.pixels);
            }
        }
    }
}

/// [`average`] for grey levels and [`SAMPLES`], in steps that the compiler turns into vector code.
fn shrink_grey(canvas: &Canvas, loss: u8, sums: &mut [u16], to: &mut [u8]) {
    let width = canvas.width();
    let strips = canvas.pixels().chunks_exact(SAMPLES * width);
    for (strip, line) in strips.zip(to.chunks_exact_mut(width / SAMPLES)) {
        let (top, bottom) = strip.split_at(2 * width);
        let ((a, b), (c, d)) = (top.split_at(width), bottom.split_at(width));
        let rows = a.iter().zip(b).zip(c).zip(d);
        for (sum, (((a, b), c), d)) in sums.iter_mut().zip(rows) {
            *sum = u16::from(*a) + u16::from(*b) + u16::from(*c) + u16::from(*d);
        }
        for (pixel, four) in line.iter_mut().zip(sums.as_chunks::<SAMPLES>().0) {
            let sum: u16 = four.iter().sum();
            *pixel = ((sum / (SAMPLES * SAMPLES) as u16) as u8).saturating_sub(loss);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn the_fast_average_is_the_plain_one(seed in prop::collection::vec(any::<u8>(), 64)) {
            let mut canvas = Canvas::new(8 * SAMPLES, 2 * SAMPLES);
            for row in 0..canvas.height() {
                for (column, pixel) in canvas.row_mut(row).iter_mut().enumerate() {
                    *pixel = seed[(row * 7 + column * 3) % seed.len()];
                }
            }
            let (mut fast, mut plain) = ([0; 16], [0; 16]);
            shrink_grey(&canvas, 2, &mut [0; 8 * SAMPLES], &mut fast);
            average(&canvas, SAMPLES, 2, |ink| [ink], &mut plain);
            prop_assert_eq!(fast, plain);
        }
    }
}
