//! Colour pictures for people, and their PNG form.

use std::path::Path;

use crate::EnvError;

/// An RGB picture, row-major, row 0 on top.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Picture {
    /// Columns.
    pub width: usize,
    /// Rows.
    pub height: usize,
    /// `width * height * 3` bytes.
    pub rgb: Vec<u8>,
}

/// Largest side of a picture that is drawn for people.
const MOST_PIXELS: usize = 4096;

impl Picture {
    /// Refuses sizes that cannot be drawn.
    ///
    /// # Errors
    /// A side of 0 pixels, or of more than 4096.
    pub fn check_size(width: usize, height: usize) -> Result<(), EnvError> {
        if [width, height].iter().all(|side| (1..=MOST_PIXELS).contains(side)) {
            return Ok(());
        }
        Err(EnvError::Picture(format!("{width} x {height} pixels, expected 1 to {MOST_PIXELS} a side")))
    }

    /// A black picture.
    pub fn new(width: usize, height: usize) -> Self {
        Self { width, height, rgb: vec![0; width * height * 3] }
    }

    /// A picture of grey levels.
    pub fn from_grey(width: usize, height: usize, grey: &[u8]) -> Self {
        Self { width, height, rgb: grey.iter().flat_map(|level| [*level; 3]).collect() }
    }

    /// Pictures side by side with a white line between them; the row is as tall as the tallest.
    pub fn strip(pictures: &[Picture]) -> Self {
        const GAP: usize = 2;
        let height = pictures.iter().map(|p| p.height).max().unwrap_or(0);
        let width = pictures.iter().map(|p| p.width + GAP).sum::<usize>().saturating_sub(GAP);
        let mut strip = Self { width, height, rgb: vec![255; width * height * 3] };
        let mut left = 0;
        for picture in pictures {
            for row in 0..picture.height {
                let from = row * picture.width * 3;
                let to = (row * width + left) * 3;
                strip.rgb[to..to + picture.width * 3]
                    .copy_from_slice(&picture.rgb[from..from + picture.width * 3]);
            }
            left += picture.width + GAP;
        }
        strip
    }

    /// The picture with every pixel `factor` times as wide and tall.
    pub fn enlarged(&self, factor: usize) -> Self {
        let mut large = Self::new(self.width * factor, self.height * factor);
        for (at, pixel) in large.rgb.chunks_exact_mut(3).enumerate() {
            let (row, column) = (at / (self.width * factor), at % (self.width * factor));
            let from = ((row / factor) * self.width + column / factor) * 3;
            pixel.copy_from_slice(&self.rgb[from..from + 3]);
        }
        large
    }

    /// The picture as a PNG file's bytes.
    ///
    /// # Errors
    /// Width or height is 0 or too large for the format.
    pub fn to_png(&self) -> Result<Vec<u8>, EnvError> {
        let side = |length: usize| {
            u32::try_from(length).map_err(|_| EnvError::Picture(format!("a side of {length} pixels")))
        };
        let mut bytes = Vec::new();
        let mut encoder = png::Encoder::new(&mut bytes, side(self.width)?, side(self.height)?);
        encoder.set_color(png::ColorType::Rgb);
        encoder.set_depth(png::BitDepth::Eight);
        let written = encoder.write_header().and_then(|mut writer| writer.write_image_data(&self.rgb));
        written.map_err(|error| {
            EnvError::Picture(format!("PNG of {} x {} pixels: {error}", self.width, self.height))
        })?;
        Ok(bytes)
    }

    /// Writes the picture to a PNG file.
    ///
    /// # Errors
    /// As [`Picture::to_png`], or the file cannot be written.
    pub fn write_png(&self, path: &Path) -> Result<(), EnvError> {
        let bytes = self.to_png()?;
        std::fs::write(path, bytes)
            .map_err(|error| EnvError::Picture(format!("cannot write {}: {error}", path.display())))
    }
}
