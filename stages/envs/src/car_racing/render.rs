//! Draws a scene as gym's CarRacing-v0 or as Gymnasium's CarRacing-v3.
//!
//! Version 0 draws plain polygons with one sample per pixel, and its view follows the velocity. Version 3 draws a window
//! of 1000 x 800 and shrinks it by area averaging, and its view follows the hull.

use super::camera::{Camera, WINDOW};
use super::indicators;
use super::paint::Painter;
use super::palette::{self, Inks, Rgb};
use super::scene::Scene;
use super::text::Text;
use super::track::Track;
use crate::CarRacingVersion;
use crate::drawing::canvas::Canvas;
use crate::drawing::coverage::AreaCanvas;
use crate::drawing::surface::Surface;

/// Lines of the bar in eighths of the image.
const BAR: usize = 8;
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

/// An image and how to draw it. Nothing is allocated once the first images are drawn.
#[derive(Clone, Debug)]
pub struct Renderer {
    version: CarRacingVersion,
    output: Output,
    pixels: Pixels,
    inks: Inks,
    colours: [Rgb; palette::COUNT],
    text: Text,
    /// Where the channels are put side by side; empty for grey.
    image: Vec<u8>,
}

/// What a pixel shows.
#[derive(Clone, Debug)]
enum Pixels {
    /// Its centre. Grey images are painted as such.
    Sampled(Canvas),
    /// The mean of its area.
    Averaged(AreaCanvas),
}

impl Renderer {
    /// Images as the original observes them, `width` x `height`.
    pub fn new(version: CarRacingVersion, output: Output, size: [usize; 2]) -> Self {
        match version {
            CarRacingVersion::V0 => {
                let pixels = Pixels::Sampled(Canvas::new(size[0], size[1]));
                Self::with_pixels(version, output, size, pixels, Text::sampled(version, size))
            }
            CarRacingVersion::V3 => Self::averaged(version, output, size),
        }
    }

    /// Images whose pixels are averages, `width` x `height`.
    pub fn averaged(version: CarRacingVersion, output: Output, size: [usize; 2]) -> Self {
        let growth = if version == CarRacingVersion::V3 { GROWTH * size[0] as f64 / WINDOW[0] } else { 0.0 };
        let loss = if version == CarRacingVersion::V3 { SHRINK_LOSS } else { 0 };
        let seen = |levels: Rgb| levels.map(|level| level.saturating_sub(loss));
        let colours = palette::rgb(version);
        let canvas = match output {
            Output::Grey => {
                let greys = colours.map(|colour| [palette::grey(colour).saturating_sub(loss)]);
                AreaCanvas::new(size[0], size[1], growth, &greys)
            }
            Output::Rgb => AreaCanvas::new(size[0], size[1], growth, &colours.map(seen)),
        };
        let text = Text::averaged(version, size, loss);
        Self::with_pixels(version, output, size, Pixels::Averaged(canvas), text)
    }

    fn with_pixels(
        version: CarRacingVersion,
        output: Output,
        [width, height]: [usize; 2],
        pixels: Pixels,
        text: Text,
    ) -> Self {
        let colours = palette::rgb(version);
        let directly = output == Output::Grey && matches!(pixels, Pixels::Sampled(_));
        Self {
            version,
            output,
            pixels,
            inks: if directly { Inks(colours.map(palette::grey)) } else { Inks::indices() },
            colours,
            text,
            image: vec![0; if output == Output::Rgb { width * height * 3 } else { 0 }],
        }
    }

    /// The last image drawn, row-major, row 0 on top.
    pub fn pixels(&self) -> &[u8] {
        match (&self.pixels, self.output) {
            (Pixels::Sampled(canvas), Output::Grey) => canvas.pixels(),
            (Pixels::Averaged(canvas), Output::Grey) => canvas.channel(0),
            (_, Output::Rgb) => &self.image,
        }
    }

    /// Draws the scene.
    pub fn draw(&mut self, track: &Track, scene: &Scene<'_>) {
        match &mut self.pixels {
            Pixels::Sampled(canvas) => paint(canvas, self.version, &self.inks, track, scene),
            Pixels::Averaged(canvas) => paint(canvas, self.version, &self.inks, track, scene),
        }
        match (&mut self.pixels, self.output) {
            (Pixels::Sampled(canvas), Output::Grey) => self.text.draw::<1>(canvas.pixels_mut(), scene.score),
            (Pixels::Averaged(canvas), Output::Grey) => {
                self.text.draw::<1>(canvas.channel_mut(0), scene.score);
            }
            (Pixels::Sampled(canvas), Output::Rgb) => {
                let colours = canvas.pixels().iter().map(|ink| self.colours[usize::from(*ink)]);
                self.image.as_chunks_mut().0.iter_mut().zip(colours).for_each(|(pixel, rgb)| *pixel = rgb);
                self.text.draw::<3>(&mut self.image, scene.score);
            }
            (Pixels::Averaged(canvas), Output::Rgb) => {
                canvas.interleave(&mut self.image);
                self.text.draw::<3>(&mut self.image, scene.score);
            }
        }
    }
}

/// Paints all but the text.
fn paint<S: Surface>(
    surface: &mut S,
    version: CarRacingVersion,
    inks: &Inks,
    track: &Track,
    scene: &Scene<'_>,
) {
    let size = surface.size();
    let camera = match version {
        CarRacingVersion::V0 => Camera::following_velocity(scene, size),
        CarRacingVersion::V3 => Camera::following_hull(scene, size),
    };
    let mut painter = Painter { surface, camera, inks, floor: size[1] - size[1] / BAR };
    painter.grass();
    painter.road(track, scene);
    painter.car(scene);
    indicators::draw(surface, scene, inks, version);
}
