//! Videos of episodes: frames are added one by one and written as GIF, animated PNG, or a strip of images.

mod gif;
pub mod panel;

use std::collections::HashMap;
use std::fs::File;
use std::io::{BufWriter, Write};
use std::path::Path;

use crate::{EnvError, RgbImage};

/// Duration of the last frame, milliseconds, before the video repeats.
const LAST: u32 = 2000;
/// Number of images in a strip.
const STRIP: usize = 6;
/// One in so many pixels is sampled for the palette; prime, so that samples cover all columns.
const SAMPLE: usize = 13;
/// Compression level of the frames in memory; even at this level, flat colours shrink to a fiftieth.
const LEVEL: i32 = 1;

/// File format of a video.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Format {
    /// An animated GIF of 255 colours.
    Gif,
    /// An animated PNG, all colours.
    Apng,
    /// Six frames side by side, as one PNG.
    Strip,
}

impl Format {
    /// The format of a file, by its extension: `gif`, `apng`, or `png` for a strip.
    ///
    /// # Errors
    /// An unknown extension; the message lists the known ones.
    pub fn of(path: &Path) -> Result<Self, EnvError> {
        let ending = path.extension().map(|ending| ending.to_string_lossy().to_ascii_lowercase());
        match ending.as_deref() {
            Some("gif") => Ok(Self::Gif),
            Some("apng") => Ok(Self::Apng),
            Some("png") => Ok(Self::Strip),
            _ => Err(EnvError::Render(format!(
                "`{}`: expected a file name ending in .gif or .apng (a video) or .png (six frames side by side)",
                path.display()
            ))),
        }
    }
}

/// Frames of one size, in order.
#[derive(Debug, Default)]
pub struct Video {
    /// Columns and rows; none before the first frame.
    size: Option<[usize; 2]>,
    /// Compressed pixels.
    frames: Vec<Vec<u8>>,
    /// Histogram of colours, over a sample of the pixels.
    colours: HashMap<[u8; 3], u64>,
}

impl Video {
    /// Adds a frame.
    ///
    /// # Errors
    /// Its size differs from the first frame's, or it is empty.
    pub fn push(&mut self, image: &RgbImage) -> Result<(), EnvError> {
        let seen = [image.width, image.height];
        let size = *self.size.get_or_insert(seen);
        if seen != size || image.rgb.is_empty() {
            return Err(wrong(format!("a frame of {seen:?} pixels, expected {size:?}")));
        }
        for pixel in image.rgb.as_chunks::<3>().0.iter().step_by(SAMPLE) {
            *self.colours.entry(*pixel).or_default() += 1;
        }
        self.frames.push(zstd::bulk::compress(&image.rgb, LEVEL).map_err(wrong)?);
        Ok(())
    }

    /// Number of frames.
    pub fn len(&self) -> usize {
        self.frames.len()
    }

    /// True before the first frame.
    pub fn is_empty(&self) -> bool {
        self.frames.is_empty()
    }

    /// One frame.
    fn frame(&self, index: usize) -> Result<RgbImage, EnvError> {
        let [width, height] = self.size.unwrap_or_default();
        let rgb = zstd::bulk::decompress(&self.frames[index], width * height * 3).map_err(wrong)?;
        Ok(RgbImage { width, height, rgb })
    }

    /// Duration of a frame in milliseconds; all but the last take `each`.
    fn lasts(&self, index: usize, each: u32) -> u32 {
        if index + 1 == self.len() { LAST } else { each }
    }

    /// Writes the video, each frame lasting `milliseconds`.
    ///
    /// # Errors
    /// There is no frame, or the file cannot be written.
    pub fn write(&self, path: &Path, format: Format, milliseconds: u32) -> Result<(), EnvError> {
        if self.is_empty() {
            return Err(wrong("a video without frames"));
        }
        let failed =
            |error: &dyn std::fmt::Display| wrong(format!("cannot write {}: {error}", path.display()));
        let file = File::create(path).map_err(|error| failed(&error))?;
        let mut file = BufWriter::new(file);
        match format {
            Format::Gif => gif::write(self, &mut file, milliseconds)?,
            Format::Apng => self.write_apng(&mut file, milliseconds)?,
            Format::Strip => {
                file.write_all(&self.strip()?.to_png()?).map_err(|error| failed(&error))?;
            }
        }
        file.flush().map_err(|error| failed(&error))
    }

    fn write_apng(&self, file: &mut impl Write, milliseconds: u32) -> Result<(), EnvError> {
        let [width, height] = self.size.unwrap_or_default();
        let mut encoder = png::Encoder::new(file, width as u32, height as u32);
        encoder.set_color(png::ColorType::Rgb);
        encoder.set_depth(png::BitDepth::Eight);
        encoder.set_animated(self.len() as u32, 0).map_err(wrong)?;
        encoder.set_frame_delay(short(milliseconds), 1000).map_err(wrong)?;
        let mut writer = encoder.write_header().map_err(wrong)?;
        for index in 0..self.len() {
            writer.set_frame_delay(short(self.lasts(index, milliseconds)), 1000).map_err(wrong)?;
            writer.write_image_data(&self.frame(index)?.rgb).map_err(wrong)?;
        }
        writer.finish().map_err(wrong)
    }

    /// Evenly spaced frames, including the first and the last.
    fn strip(&self) -> Result<RgbImage, EnvError> {
        let count = STRIP.min(self.len());
        let at = |n: usize| n * (self.len() - 1) / (count - 1).max(1);
        let images = (0..count).map(|n| self.frame(at(n))).collect::<Result<Vec<_>, EnvError>>()?;
        Ok(RgbImage::strip(&images))
    }
}

fn wrong(error: impl std::fmt::Display) -> EnvError {
    EnvError::Render(error.to_string())
}

fn short(number: u32) -> u16 {
    u16::try_from(number).unwrap_or(u16::MAX)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A bright square that moves over a dark ground with many shades.
    fn video(frames: usize) -> Video {
        let mut video = Video::default();
        for n in 0..frames {
            let mut image = RgbImage::new(40, 30);
            for (at, pixel) in image.rgb.chunks_exact_mut(3).enumerate() {
                let (x, y) = (at % 40, at / 40);
                let inside = (n..n + 10).contains(&x) && y < 10;
                pixel.copy_from_slice(&if inside { [255, 0, 0] } else { [x as u8, 4 * y as u8, n as u8] });
            }
            video.push(&image).unwrap();
        }
        video
    }

    #[test]
    fn the_ending_says_what_is_written() {
        assert_eq!(Format::of(Path::new("a/lap.gif")), Ok(Format::Gif));
        assert_eq!(Format::of(Path::new("lap.APNG")), Ok(Format::Apng));
        assert_eq!(Format::of(Path::new("lap.png")), Ok(Format::Strip));
        let error = Format::of(Path::new("lap.mp4")).unwrap_err().to_string();
        assert!(error.contains("lap.mp4") && error.contains(".gif or .apng"), "{error}");
    }

    #[test]
    fn a_gif_shows_every_frame_in_nearly_its_colours() {
        let (folder, video) = (tempfile::tempdir().unwrap(), video(12));
        let path = folder.path().join("lap.gif");
        video.write(&path, Format::Gif, 40).unwrap();
        let mut options = ::gif::DecodeOptions::new();
        options.set_color_output(::gif::ColorOutput::RGBA);
        let mut decoder = options.read_info(File::open(&path).unwrap()).unwrap();
        let mut canvas = vec![0u8; 40 * 30 * 4];
        let (mut frames, mut delays) = (0, Vec::new());
        while let Some(frame) = decoder.read_next_frame().unwrap() {
            delays.push(frame.delay);
            for (row, line) in frame.buffer.chunks_exact(usize::from(frame.width) * 4).enumerate() {
                for (column, pixel) in line.chunks_exact(4).enumerate().filter(|(_, pixel)| pixel[3] > 0) {
                    let at = (usize::from(frame.top) + row) * 40 + usize::from(frame.left) + column;
                    canvas[4 * at..4 * at + 4].copy_from_slice(pixel);
                }
            }
            let wanted = video.frame(frames).unwrap();
            for (seen, wanted) in canvas.chunks_exact(4).zip(wanted.rgb.chunks_exact(3)) {
                let off = seen.iter().zip(wanted).map(|(a, b)| a.abs_diff(*b)).max().unwrap();
                assert!(off <= 24, "frame {frames}: {seen:?}, expected {wanted:?}");
            }
            frames += 1;
        }
        assert_eq!(frames, 12);
        assert_eq!((delays[0], delays[11]), (4, 200));
    }

    #[test]
    fn an_apng_has_every_frame_exactly() {
        let (folder, video) = (tempfile::tempdir().unwrap(), video(5));
        let path = folder.path().join("lap.apng");
        video.write(&path, Format::Apng, 40).unwrap();
        let decoder = png::Decoder::new(std::io::BufReader::new(File::open(&path).unwrap()));
        let mut reader = decoder.read_info().unwrap();
        assert_eq!(reader.info().animation_control().unwrap().num_frames, 5);
        for index in 0..5 {
            let mut rgb = vec![0; 40 * 30 * 3];
            reader.next_frame(&mut rgb).unwrap();
            assert_eq!(rgb, video.frame(index).unwrap().rgb);
        }
    }

    #[test]
    fn a_strip_shows_the_first_and_the_last_moment() {
        for frames in [1, 3, 20] {
            let video = video(frames);
            let strip = video.strip().unwrap();
            let count = frames.min(STRIP);
            assert_eq!((strip.width, strip.height), (42 * count - 2, 30));
            let last = video.frame(frames - 1).unwrap();
            assert_eq!(strip.rgb[(strip.width - 40) * 3..strip.width * 3], last.rgb[..40 * 3]);
        }
    }

    #[test]
    fn frames_of_two_sizes_make_no_video() {
        let mut video = video(1);
        assert!(video.push(&RgbImage::new(40, 31)).is_err());
        assert!(Video::default().write(Path::new("x.gif"), Format::Gif, 40).is_err());
    }
}
