//! GIF: one palette for the whole video; each frame stores only the changed rectangle.

use std::collections::{HashMap, HashSet};
use std::io::Write;

use super::{Video, wrong};
use crate::EnvError;

/// Colours of the palette; one more index means "unchanged".
const COLOURS: usize = 255;
const UNCHANGED: u8 = 255;
/// The most frequent colours are kept exactly; the others are quantised.
const EXACT: usize = 128;

/// Writes the video, each frame lasting `milliseconds`.
pub(super) fn write(video: &Video, to: &mut impl Write, milliseconds: u32) -> Result<(), EnvError> {
    let [width, height] = video.size.unwrap_or_default();
    let side = |length: usize| u16::try_from(length).map_err(wrong);
    let mut palette = Palette::new(&video.colours);
    let mut encoder = gif::Encoder::new(to, side(width)?, side(height)?, &palette.bytes()).map_err(wrong)?;
    encoder.set_repeat(gif::Repeat::Infinite).map_err(wrong)?;
    let mut before: Option<Vec<u8>> = None;
    for index in 0..video.len() {
        let now = palette.indices(&video.frame(index)?.rgb);
        let changed = before.as_ref().map_or([0, 0, width, height], |before| changed(before, &now, width));
        let mut frame = cut(before.as_deref(), &now, width, changed)?;
        frame.delay = super::short(video.lasts(index, milliseconds) / 10);
        encoder.write_frame(&frame).map_err(wrong)?;
        before = Some(now);
    }
    Ok(())
}

/// Left, top, right and bottom of the changed rectangle; one pixel if nothing changed.
fn changed(before: &[u8], now: &[u8], width: usize) -> [usize; 4] {
    let mut found: Option<[usize; 4]> = None;
    for at in before.iter().zip(now).enumerate().filter(|(_, (a, b))| a != b).map(|(at, _)| at) {
        let (x, y) = (at % width, at / width);
        let [left, top, right, bottom] = found.unwrap_or([x, y, x + 1, y + 1]);
        found = Some([left.min(x), top.min(y), right.max(x + 1), bottom.max(y + 1)]);
    }
    found.unwrap_or([0, 0, 1, 1])
}

fn cut(
    before: Option<&[u8]>,
    now: &[u8],
    width: usize,
    [left, top, right, bottom]: [usize; 4],
) -> Result<gif::Frame<'static>, EnvError> {
    let mut buffer = Vec::with_capacity((right - left) * (bottom - top));
    for row in top..bottom {
        for at in row * width + left..row * width + right {
            let same = before.is_some_and(|before| before[at] == now[at]);
            buffer.push(if same { UNCHANGED } else { now[at] });
        }
    }
    let side = |length: usize| u16::try_from(length).map_err(wrong);
    Ok(gif::Frame {
        left: side(left)?,
        top: side(top)?,
        width: side(right - left)?,
        height: side(bottom - top)?,
        dispose: gif::DisposalMethod::Keep,
        transparent: Some(UNCHANGED),
        buffer: buffer.into(),
        ..gif::Frame::default()
    })
}

/// Up to [`COLOURS`] colours, and a cache of the nearest one for each colour seen.
struct Palette {
    colours: Vec<[u8; 3]>,
    known: HashMap<[u8; 3], u8>,
}

impl Palette {
    fn new(seen: &HashMap<[u8; 3], u64>) -> Self {
        let mut by_count: Vec<([u8; 3], u64)> =
            seen.iter().map(|(colour, count)| (*colour, *count)).collect();
        // The order of a map is arbitrary: ties are broken by colour.
        by_count.sort_by_key(|(colour, count)| (std::cmp::Reverse(*count), *colour));
        let exact = if by_count.len() <= COLOURS { by_count.len() } else { EXACT };
        let mut colours: Vec<[u8; 3]> = by_count[..exact].iter().map(|(colour, _)| *colour).collect();
        if exact < by_count.len() {
            let rest: Vec<u8> = by_count[exact..]
                .iter()
                .flat_map(|(colour, _)| [colour[0], colour[1], colour[2], 255])
                .collect();
            let grouped = color_quant::NeuQuant::new(1, COLOURS - exact, &rest).color_map_rgb();
            let mut have: HashSet<[u8; 3]> = colours.iter().copied().collect();
            colours.extend(grouped.as_chunks::<3>().0.iter().filter(|colour| have.insert(**colour)));
        }
        Self { colours, known: HashMap::new() }
    }

    /// Red, green and blue of each index, including the last one.
    fn bytes(&self) -> Vec<u8> {
        let mut bytes = self.colours.as_flattened().to_vec();
        bytes.resize(3 * (COLOURS + 1), 0);
        bytes
    }

    fn indices(&mut self, rgb: &[u8]) -> Vec<u8> {
        let mut last = ([0; 3], None);
        let index = |pixel: &[u8; 3]| match last {
            // Most pixels equal the previous one.
            (colour, Some(index)) if colour == *pixel => index,
            _ => {
                let colours = &self.colours;
                let index = *self.known.entry(*pixel).or_insert_with(|| nearest(colours, *pixel));
                last = (*pixel, Some(index));
                index
            }
        };
        rgb.as_chunks::<3>().0.iter().map(index).collect()
    }
}

fn nearest(colours: &[[u8; 3]], pixel: [u8; 3]) -> u8 {
    let distance = |colour: &[u8; 3]| -> u32 {
        colour.iter().zip(pixel).map(|(a, b)| u32::from(a.abs_diff(b)).pow(2)).sum()
    };
    let best = colours.iter().enumerate().min_by_key(|(_, colour)| distance(colour));
    best.map_or(0, |(index, _)| index as u8)
}
