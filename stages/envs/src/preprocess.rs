//! The thesis's view of a CarRacing picture: grey, 84 x 84 by area averaging.

use crate::car_racing::palette::grey;

/// Side of the original's observation, pixels.
pub const FULL: usize = 96;
/// Side of what the policy sees, pixels.
pub const SIDE: usize = 84;
/// Eight pixels become seven; the pattern repeats every eight.
const BLOCKS: usize = FULL / 8;

/// Grey levels of an RGB picture.
pub fn to_grey(rgb: &[u8], grey_levels: &mut [u8]) {
    for (level, pixel) in grey_levels.iter_mut().zip(rgb.chunks_exact(3)) {
        *level = grey([pixel[0], pixel[1], pixel[2]]);
    }
}

/// Weights of two neighbours in eighths: the part of each that lies under the output pixel.
const FIRST: [u16; 8] = [7, 6, 5, 4, 3, 2, 1, 0];
const SECOND: [u16; 8] = [1, 2, 3, 4, 5, 6, 7, 0];

/// Area average of 96 x 96 grey levels to 84 x 84, rounded to nearest, ties to even, as OpenCV's `INTER_AREA` does: all
/// weights are multiples of 1/64, so integers are exact.
pub fn shrink(from: &[u8; FULL * FULL], to: &mut [u8; SIDE * SIDE]) {
    for row in 0..SIDE {
        let (block, part) = (row / 7, row % 7);
        let upper = &from[(8 * block + part) * FULL..][..2 * FULL];
        let (first, second) = (FIRST[part], SECOND[part]);
        let mut sums = [0u16; FULL + 8];
        for column in 0..FULL {
            sums[column] = first * u16::from(upper[column]) + second * u16::from(upper[column + FULL]);
        }
        // Each block writes an eighth value, which the next overwrites.
        let mut line = [0u8; SIDE + 1];
        for block in 0..BLOCKS {
            let (inputs, outputs) = (&sums[8 * block..8 * block + 9], &mut line[7 * block..7 * block + 8]);
            for lane in 0..8 {
                let sum = FIRST[lane] * inputs[lane] + SECOND[lane] * inputs[lane + 1];
                outputs[lane] = ((sum + 31 + ((sum >> 6) & 1)) >> 6) as u8;
            }
        }
        to[row * SIDE..(row + 1) * SIDE].copy_from_slice(&line[..SIDE]);
    }
}
