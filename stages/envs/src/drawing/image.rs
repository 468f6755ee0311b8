//! RGB images for display, and PNG encoding.

use std::path::Path;

use crate::EnvError;

/// An RGB image, row-major, row 0 on top.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct RgbImage {
    /// Columns.
    pub width: usize,
    /// Rows.
    pub height: usize,
    /// `width * height * 3` bytes.
    pub rgb: Vec<u8>,
}

/// Largest side of a rendered image.
const MOST_PIXELS: usize = 4096;

impl RgbImage {
    /// Checks a requested size.
    ///
    /// # Errors
    /// A side of 0 pixels, or of more than 4096.
    pub fn check_size(width: usize, height: usize) -> Result<(), EnvError> {
        if [width, height].iter().all(|side| (1..=MOST_PIXELS).contains(side)) {
            return Ok(());
        }
        Err(EnvError::Render(format!("{width} x {height} pixels, expected 1 to {MOST_PIXELS} a side")))
    }

    /// A black image.
    pub fn new(width: usize, height: usize) -> Self {
        Self { width, height, rgb: vec![0; width * height * 3] }
    }

    /// An image from grey levels.
    pub fn from_grey(width: usize, height: usize, grey: &[u8]) -> Self {
        Self { width, height, rgb: grey.iter().flat_map(|level| [*level; 3]).collect() }
    }

    /// Images side by side, separated by white lines; as tall as the tallest.
    pub fn strip(images: &[RgbImage]) -> Self {
        const GAP: usize = 2;
        let height = images.iter().map(|p| p.height).max().unwrap_or(0);
        let width = images.iter().map(|p| p.width + GAP).sum::<usize>().saturating_sub(GAP);
        let mut strip = Self { width, height, rgb: vec![255; width * height * 3] };
        let mut left = 0;
        for image in images {
            for row in 0..image.height {
                let from = row * image.width * 3;
                let to = (row * width + left) * 3;
                strip.rgb[to..to + image.width * 3].copy_from_slice(&image.rgb[from..from + image.width * 3]);
            }
            left += image.width + GAP;
        }
        strip
    }

    /// The image with every pixel `factor` times as wide and tall.
    pub fn enlarged(&self, factor: usize) -> Self {
        let mut large = Self::new(self.width * factor, self.height * factor);
        for (at, pixel) in large.rgb.chunks_exact_mut(3).enumerate() {
            let (row, column) = (at / (self.width * factor), at % (self.width * factor));
            let from = ((row / factor) * self.width + column / factor) * 3;
            pixel.copy_from_slice(&self.rgb[from..from + 3]);
        }
        large
    }

    /// The image as a PNG file's bytes.
    ///
    /// # Errors
    /// Width or height is 0 or too large for the format.
    pub fn to_png(&self) -> Result<Vec<u8>, EnvError> {
        let side = |length: usize| {
            u32::try_from(length).map_err(|_| EnvError::Render(format!("a side of {length} pixels")))
        };
        let mut bytes = Vec::new();
        let mut encoder = png::Encoder::new(&mut bytes, side(self.width)?, side(self.height)?);
        encoder.set_color(png::ColorType::Rgb);
        encoder.set_depth(png::BitDepth::Eight);
        let written = encoder.write_header().and_then(|mut writer| writer.write_image_data(&self.rgb));
        written.map_err(|error| {
            EnvError::Render(format!("PNG of {} x {} pixels: {error}", self.width, self.height))
        })?;
        Ok(bytes)
    }

    /// Writes the image to a PNG file.
    ///
    /// # Errors
    /// As [`RgbImage::to_png`], or the file cannot be written.
    pub fn write_png(&self, path: &Path) -> Result<(), EnvError> {
        let bytes = self.to_png()?;
        std::fs::write(path, bytes)
            .map_err(|error| EnvError::Render(format!("cannot write {}: {error}", path.display())))
    }
}
