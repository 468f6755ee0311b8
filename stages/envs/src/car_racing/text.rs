//! The score in the corner of the bar: four digits, as strokes of a sans-serif face.

use std::ops::Range;

use dril_stage_api::math;

use super::camera::WINDOW;
use crate::CarRacingVersion;

/// How the text is set, window pixels, y up.
#[derive(Clone, Copy, Debug)]
struct Face {
    /// Left edge and baseline.
    origin: [f64; 2],
    /// From one character to the next.
    advance: f64,
    /// Height of a digit.
    height: f64,
    /// Half the width of a stroke.
    half_stroke: f64,
}

/// A sans-serif of 36 points at 96 dots per inch.
const FACE_V0: Face = Face { origin: [20.0, 29.4], advance: 30.5, height: 36.0, half_stroke: 2.6 };
/// A bold sans-serif of 42 pixels.
const FACE_V3: Face = Face { origin: [13.0, 35.0], advance: 23.5, height: 30.0, half_stroke: 3.2 };
/// Characters shown.
const SLOTS: usize = 4;
/// The glyphs of the digits, then the minus sign.
const GLYPHS: usize = 11;
const MINUS: usize = 10;
/// Shades of text from black to white, less one.
const WHITE: u32 = 15;
/// Samples per pixel and axis where pixels are averages.
const SAMPLES: usize = 4;

/// A stroke: points joined by lines, in a box of 0..10 across and 0..14 up.
type Stroke = &'static [[f64; 2]];

const ROUND: Stroke = &[
    [5.0, 13.3],
    [3.2, 12.6],
    [2.1, 10.6],
    [1.8, 7.0],
    [2.1, 3.4],
    [3.2, 1.4],
    [5.0, 0.7],
    [6.8, 1.4],
    [7.9, 3.4],
    [8.2, 7.0],
    [7.9, 10.6],
    [6.8, 12.6],
    [5.0, 13.3],
];
const LOWER_BOWL: Stroke = &[
    [5.0, 7.6],
    [3.2, 7.2],
    [2.0, 5.9],
    [1.7, 4.1],
    [2.2, 2.2],
    [3.4, 1.0],
    [5.0, 0.7],
    [6.6, 1.0],
    [7.8, 2.2],
    [8.3, 4.1],
    [8.0, 5.9],
    [6.8, 7.2],
    [5.0, 7.6],
];
const UPPER_BOWL: Stroke = &[
    [5.0, 13.3],
    [3.4, 12.9],
    [2.3, 11.9],
    [2.1, 10.3],
    [2.6, 8.8],
    [3.6, 7.9],
    [5.0, 7.6],
    [6.4, 7.9],
    [7.4, 8.8],
    [7.9, 10.3],
    [7.7, 11.9],
    [6.6, 12.9],
    [5.0, 13.3],
];

const STROKES: [&[Stroke]; GLYPHS] = [
    &[ROUND],
    &[&[[2.4, 12.4], [5.3, 13.3], [5.3, 1.0]], &[[2.4, 1.0], [8.2, 1.0]]],
    &[&[[2.0, 12.6], [4.2, 13.3], [6.2, 12.9], [7.5, 11.6], [7.6, 9.8], [6.6, 7.8], [2.0, 1.0], [8.2, 1.0]]],
    &[
        &[[2.2, 12.9], [4.6, 13.3], [6.6, 12.6], [7.5, 11.0], [7.2, 9.0], [6.0, 7.6], [4.2, 7.3]],
        &[[4.2, 7.3], [6.4, 6.9], [7.9, 5.3], [8.0, 3.4], [7.0, 1.6], [5.0, 0.7], [3.2, 0.8], [1.8, 1.4]],
    ],
    &[&[[6.6, 1.0], [6.6, 13.2], [1.6, 4.2], [8.8, 4.2]]],
    &[&[
        [7.6, 13.3],
        [2.7, 13.3],
        [2.7, 8.2],
        [4.6, 8.4],
        [6.6, 7.8],
        [7.9, 6.1],
        [8.1, 4.2],
        [7.4, 2.2],
        [5.8, 0.9],
        [3.8, 0.7],
        [1.9, 1.3],
    ]],
    &[LOWER_BOWL, &[[7.6, 12.9], [5.8, 13.3], [3.8, 12.5], [2.3, 10.2], [1.7, 7.0], [1.7, 4.1]]],
    &[&[[1.8, 13.3], [8.0, 13.3], [4.0, 1.0]]],
    &[LOWER_BOWL, UPPER_BOWL],
    &[UPPER_BOWL, &[[8.3, 9.9], [8.3, 7.0], [7.7, 3.8], [6.2, 1.5], [4.2, 0.7], [2.4, 1.1]]],
    &[&[[2.2, 5.4], [7.8, 5.4]]],
];

/// The characters as they fall on the pixels of one image size.
#[derive(Clone, Debug)]
pub struct Text {
    /// Columns of the image.
    width: usize,
    /// What becomes of a pixel under a glyph.
    cover: fn(u8, u8) -> u8,
    rows: Range<usize>,
    slots: [Slot; SLOTS],
}

#[derive(Clone, Debug, Default)]
struct Slot {
    columns: Range<usize>,
    /// Per glyph, row by row: grey levels.
    levels: [Vec<u8>; GLYPHS],
}

impl Text {
    /// The characters for images of `width` x `height`, sampled in the pixels' centres.
    pub fn sampled(version: CarRacingVersion, [width, height]: [usize; 2]) -> Self {
        // What is seen in a sample is the text or what it stands on.
        Self::new(version, [width, height], 1, |_, text| text)
    }

    /// The characters for images whose pixels are means, of which every level has lost `loss`.
    pub fn averaged(version: CarRacingVersion, [width, height]: [usize; 2], loss: u8) -> Self {
        let mut text = Self::new(version, [width, height], SAMPLES, u8::max);
        for levels in text.slots.iter_mut().flat_map(|slot| &mut slot.levels) {
            levels.iter_mut().for_each(|level| *level = level.saturating_sub(loss));
        }
        text
    }

    fn new(
        version: CarRacingVersion,
        [width, height]: [usize; 2],
        samples: usize,
        cover: fn(u8, u8) -> u8,
    ) -> Self {
        let face = if version == CarRacingVersion::V3 { FACE_V3 } else { FACE_V0 };
        let scale = [width as f64 / WINDOW[0], height as f64 / WINDOW[1]];
        let margin = face.half_stroke + 1.0;
        let row = |y: f64| ((WINDOW[1] - y) * scale[1]) as usize;
        let rows = row(face.origin[1] + face.height + margin)..(row(face.origin[1] - margin) + 1).min(height);
        let slot = |n: usize| {
            let left = face.origin[0] + n as f64 * face.advance;
            let columns =
                (left * scale[0]) as usize..(((left + face.advance) * scale[0]) as usize + 1).min(width);
            let shade = |glyph: usize, row: f64, column: f64| {
                let at = [column / scale[0] - left, WINDOW[1] - row / scale[1] - face.origin[1]];
                face.shade(STROKES[glyph], at)
            };
            let level = |glyph: usize, row: usize, column: usize| {
                let within = |sample: usize| (sample as f64 + 0.5) / samples as f64;
                let all = (0..samples * samples).map(|sample| {
                    let (down, right) = (within(sample / samples), within(sample % samples));
                    shade(glyph, row as f64 + down, column as f64 + right)
                });
                (all.sum::<u32>() * 255 / WHITE / (samples * samples) as u32) as u8
            };
            let levels = std::array::from_fn(|glyph| {
                let pixels = rows.clone().flat_map(|row| columns.clone().map(move |column| (row, column)));
                pixels.map(|(row, column)| level(glyph, row, column)).collect()
            });
            Slot { columns, levels }
        };
        Self { width, cover, slots: std::array::from_fn(slot), rows }
    }

    /// Draws the score's whole part over an image with `N` channels.
    pub fn draw<const N: usize>(&self, pixels: &mut [u8], score: f64) {
        let rows = self.rows.clone();
        for (slot, glyph) in self.slots.iter().zip(characters(score)) {
            let mut levels = slot.levels[glyph].iter();
            for line in pixels.chunks_exact_mut(self.width * N).take(rows.end).skip(rows.start) {
                let pixels = &mut line.as_chunks_mut::<N>().0[slot.columns.clone()];
                for (pixel, level) in pixels.iter_mut().zip(&mut levels).filter(|(_, level)| **level > 0) {
                    *pixel = pixel.map(|below| (self.cover)(below, *level));
                }
            }
        }
    }
}

/// Glyphs of the score with leading zeros; the sign takes a place.
fn characters(score: f64) -> [usize; SLOTS] {
    let whole = score.trunc().clamp(-999.0, 9999.0) as i32;
    let mut rest = whole.unsigned_abs() as usize;
    let mut glyphs = [0; SLOTS];
    for glyph in glyphs.iter_mut().rev() {
        *glyph = rest % 10;
        rest /= 10;
    }
    if whole < 0 {
        glyphs[0] = MINUS;
    }
    glyphs
}

impl Face {
    /// How much a point is covered by strokes: full inside, fading over a window pixel at the edge.
    fn shade(&self, strokes: &[Stroke], point: [f64; 2]) -> u32 {
        let unit = [self.advance / 10.0, self.height / 14.0];
        let mut least = f64::INFINITY;
        for stroke in strokes {
            for ends in stroke.windows(2) {
                let [from, to] = [0, 1].map(|end| [ends[end][0] * unit[0], ends[end][1] * unit[1]]);
                least = least.min(distance(point, from, to));
            }
        }
        let cover = (self.half_stroke + 0.5 - least).clamp(0.0, 1.0);
        (cover * f64::from(WHITE)).round() as u32
    }
}

fn distance([x, y]: [f64; 2], from: [f64; 2], to: [f64; 2]) -> f64 {
    let [dx, dy] = [to[0] - from[0], to[1] - from[1]];
    let (px, py) = (x - from[0], y - from[1]);
    let along = ((px * dx + py * dy) / (dx * dx + dy * dy)).clamp(0.0, 1.0);
    math::hypot(px - along * dx, py - along * dy)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn scores_are_shown_with_four_characters() {
        assert_eq!(characters(7.9), [0, 0, 0, 7]);
        assert_eq!(characters(926.3), [0, 9, 2, 6]);
        assert_eq!(characters(-0.9), [0, 0, 0, 0]);
        assert_eq!(characters(-42.0), [MINUS, 0, 4, 2]);
        assert_eq!(characters(f64::NAN), [0, 0, 0, 0]);
    }

    #[test]
    fn digits_look_different_in_the_observation() {
        let image = |score: f64| {
            let mut pixels = vec![0; 96 * 96];
            Text::sampled(CarRacingVersion::V0, [96; 2]).draw::<1>(&mut pixels, score);
            pixels
        };
        let images: Vec<_> = (0..10).map(|digit| image(f64::from(digit))).collect();
        for (i, one) in images.iter().enumerate() {
            assert!(images[..i].iter().all(|other| other != one), "{i}");
        }
    }
}
