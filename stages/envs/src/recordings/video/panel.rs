//! The bar under an image: score, step, and a gauge for every value of the action.

use noto_sans_mono_bitmap::{FontWeight, RasterHeight, get_raster, get_raster_width};

use crate::{Outcome, RgbImage};

/// Rows that the bar adds.
pub const HEIGHT: usize = 60;
/// The least width at which everything has its place.
pub const LEAST_WIDTH: usize = 360;
const GROUND: [u8; 3] = [24, 26, 30];
const LABEL: [u8; 3] = [148, 154, 164];
const VALUE: [u8; 3] = [240, 242, 245];
const TROUGH: [u8; 3] = [56, 60, 68];
const GOOD: [u8; 3] = [92, 200, 120];
const BAD: [u8; 3] = [236, 110, 80];
const FORWARD: [u8; 3] = [92, 200, 120];
const BACKWARD: [u8; 3] = [242, 160, 64];
/// Left edge of everything, and the room to the right edge.
const MARGIN: usize = 14;
/// Rows of the labels' and the values' tops.
const ROWS: [usize; 2] = [8, 27];
/// Where the step and the gauges begin.
const COLUMNS: [usize; 2] = [104, 196];
/// Between two gauges.
const GAP: usize = 16;

/// One value of an action.
#[derive(Clone, Debug, PartialEq)]
pub enum Gauge {
    /// A number from -1 to 1.
    Bar {
        /// What it moves.
        label: String,
        /// The number.
        value: f32,
    },
    /// One of several choices.
    Choice {
        /// What can be chosen.
        labels: Vec<String>,
        /// What was.
        chosen: usize,
    },
}

/// What the bar says.
#[derive(Clone, Debug, PartialEq)]
pub struct Reading<'a> {
    /// The score so far.
    pub score: f64,
    /// Steps so far.
    pub step: u64,
    /// How the episode stands.
    pub outcome: Outcome,
    /// The action.
    pub gauges: &'a [Gauge],
}

/// The image with the bar under it.
pub fn under(image: &RgbImage, reading: &Reading<'_>) -> RgbImage {
    let (width, top) = (image.width, image.height);
    let mut whole = RgbImage { width, height: top + HEIGHT, rgb: image.rgb.clone() };
    whole.rgb.extend(GROUND.repeat(width * HEIGHT));
    let mut ink = Ink { image: &mut whole, top };
    ink.small(MARGIN, ROWS[0], "SCORE", LABEL);
    ink.large(MARGIN, ROWS[1], &format!("{:.0}", reading.score), VALUE);
    let (word, colour) = match reading.outcome {
        Outcome::Running => ("STEP", LABEL),
        Outcome::Finished => ("FINISHED", GOOD),
        Outcome::Failed => ("FAILED", BAD),
        Outcome::TimeLimit => ("TIME LIMIT", LABEL),
    };
    ink.small(COLUMNS[0], ROWS[0], word, colour);
    ink.large(COLUMNS[0], ROWS[1], &reading.step.to_string(), VALUE);
    let room = width.saturating_sub(COLUMNS[1] + MARGIN);
    let count = reading.gauges.len().max(1);
    let each = (room.saturating_sub(GAP * (count - 1))) / count;
    for (index, gauge) in reading.gauges.iter().enumerate() {
        ink.gauge(COLUMNS[1] + index * (each + GAP), each, gauge);
    }
    whole
}

struct Ink<'a> {
    image: &'a mut RgbImage,
    /// The bar's first row.
    top: usize,
}

impl Ink<'_> {
    fn small(&mut self, x: usize, y: usize, text: &str, colour: [u8; 3]) {
        self.text(x, y, text, colour, (FontWeight::Regular, RasterHeight::Size16));
    }

    fn large(&mut self, x: usize, y: usize, text: &str, colour: [u8; 3]) {
        self.text(x, y, text, colour, (FontWeight::Bold, RasterHeight::Size24));
    }

    fn text(&mut self, x: usize, y: usize, text: &str, colour: [u8; 3], face: (FontWeight, RasterHeight)) {
        let advance = get_raster_width(face.0, face.1);
        for (n, character) in text.chars().enumerate() {
            let Some(glyph) = get_raster(character, face.0, face.1).or(get_raster('?', face.0, face.1))
            else {
                continue;
            };
            for (row, line) in glyph.rows().enumerate() {
                for (column, cover) in line.iter().enumerate() {
                    self.blend(x + n * advance + column, y + row, colour, *cover);
                }
            }
        }
    }

    fn blend(&mut self, x: usize, y: usize, colour: [u8; 3], cover: u8) {
        let (width, row) = (self.image.width, self.top + y);
        if x >= width || row >= self.image.height {
            return;
        }
        let at = 3 * (row * width + x);
        for (below, above) in self.image.rgb[at..at + 3].iter_mut().zip(colour) {
            let mixed = u32::from(*below) * (255 - u32::from(cover)) + u32::from(above) * u32::from(cover);
            *below = ((mixed + 127) / 255) as u8;
        }
    }

    fn fill(&mut self, x: std::ops::Range<usize>, y: std::ops::Range<usize>, colour: [u8; 3]) {
        for row in y {
            for column in x.clone() {
                self.blend(column, row, colour, 255);
            }
        }
    }

    fn gauge(&mut self, x: usize, width: usize, gauge: &Gauge) {
        match gauge {
            Gauge::Bar { label, value } => {
                self.small(x, ROWS[0], &fitted(label, width), LABEL);
                let middle = x + width / 2;
                let rows = ROWS[1] + 6..ROWS[1] + 18;
                self.fill(x..x + width, rows.clone(), TROUGH);
                let value = if value.is_nan() { 0.0 } else { value.clamp(-1.0, 1.0) };
                let length = (value.abs() * (width / 2) as f32).round() as usize;
                let (from, colour) =
                    if value < 0.0 { (middle - length, BACKWARD) } else { (middle, FORWARD) };
                self.fill(from..from + length, rows, colour);
                self.fill(middle..middle + 1, ROWS[1] + 3..ROWS[1] + 21, VALUE);
            }
            Gauge::Choice { labels, chosen } => {
                let each = width / labels.len().max(1);
                for (index, label) in labels.iter().enumerate() {
                    let left = x + index * each;
                    let colours = if index == *chosen { (FORWARD, GROUND) } else { (TROUGH, LABEL) };
                    self.fill(left..left + each.saturating_sub(4), 18..44, colours.0);
                    self.small(left + 5, 23, &fitted(label, each.saturating_sub(12)), colours.1);
                }
            }
        }
    }
}

/// As much of a label as there is room for.
fn fitted(label: &str, width: usize) -> String {
    let characters = width / get_raster_width(FontWeight::Regular, RasterHeight::Size16).max(1);
    label.chars().take(characters).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn bar(value: f32) -> Vec<Gauge> {
        vec![Gauge::Bar { label: "steer".into(), value }]
    }

    fn drawn(gauges: &[Gauge], score: f64) -> RgbImage {
        let reading = Reading { score, step: 7, outcome: Outcome::Running, gauges };
        under(&RgbImage::new(480, 20), &reading)
    }

    /// Columns of the gauge's row that have this colour.
    fn columns(image: &RgbImage, colour: [u8; 3]) -> Vec<usize> {
        let row = 20 + ROWS[1] + 10;
        let line = &image.rgb[row * 480 * 3..(row + 1) * 480 * 3];
        (0..480).filter(|x| line[3 * x..3 * x + 3] == colour).collect()
    }

    #[test]
    fn the_image_stays_as_it_is_above_the_bar() {
        let image = drawn(&bar(0.5), 1.0);
        assert_eq!((image.width, image.height), (480, 20 + HEIGHT));
        assert!(image.rgb[..480 * 20 * 3].iter().all(|value| *value == 0));
    }

    #[test]
    fn gauges_grow_from_the_middle_to_the_side_of_the_sign() {
        let width = 480 - COLUMNS[1] - MARGIN;
        let middle = COLUMNS[1] + width / 2;
        let right = columns(&drawn(&bar(0.5), 0.0), FORWARD);
        assert!(right.iter().all(|x| *x > middle) && right.len().abs_diff(width / 4) < 2, "{right:?}");
        let left = columns(&drawn(&bar(-2.0), 0.0), BACKWARD);
        assert!(left.iter().all(|x| *x < middle) && left.len().abs_diff(width / 2) < 2, "{left:?}");
        assert!(columns(&drawn(&bar(f32::NAN), 0.0), FORWARD).is_empty());
    }

    #[test]
    fn numbers_and_choices_are_seen() {
        assert_ne!(drawn(&bar(0.0), 812.0), drawn(&bar(0.0), 813.0));
        let choice =
            |chosen| vec![Gauge::Choice { labels: ["NOOP", "FIRE"].map(String::from).to_vec(), chosen }];
        assert_ne!(drawn(&choice(0), 0.0), drawn(&choice(1), 0.0));
    }

    #[test]
    fn a_narrow_image_is_drawn_as_far_as_it_goes() {
        let reading = Reading { score: 1.0, step: 1, outcome: Outcome::Failed, gauges: &bar(1.0) };
        assert_eq!(under(&RgbImage::new(30, 5), &reading).rgb.len(), 30 * (5 + HEIGHT) * 3);
    }
}
