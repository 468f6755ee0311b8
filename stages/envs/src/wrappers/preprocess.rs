//! The thesis's preprocessing of a CarRacing image: greyscale, 84 x 84 by area averaging.

use crate::car_racing::palette::grey;

/// Side of the original's observation, pixels.
pub const FULL: usize = 96;
/// Side of the policy's observation, pixels.
pub const SIDE: usize = 84;
/// Converts RGB pixels to grey levels.
pub fn to_grey(rgb: &[u8], grey_levels: &mut [u8]) {
    for (level, pixel) in grey_levels.iter_mut().zip(rgb.chunks_exact(3)) {
        *level = grey([pixel[0], pixel[1], pixel[2]]);
    }
}

/// Weight of an input pixel in the output pixel at its position, in eighths: the overlap.
const FIRST: [u16; 8] = [7, 6, 5, 4, 3, 2, 1, 0];
/// Weight of its right or lower neighbour. Every eighth output pixel is unused.
const SECOND: [u16; 8] = [1, 2, 3, 4, 5, 6, 7, 0];
/// The same for all columns of a row.
const FIRSTS: [u16; FULL] = repeated(&FIRST);
const SECONDS: [u16; FULL] = repeated(&SECOND);

const fn repeated(weights: &[u16; 8]) -> [u16; FULL] {
    let mut all = [0; FULL];
    let mut column = 0;
    while column < FULL {
        all[column] = weights[column % 8];
        column += 1;
    }
    all
}

/// Area average of 96 x 96 grey levels to 84 x 84, rounded to nearest, ties to even, as OpenCV's `INTER_AREA` does: all
/// weights are multiples of 1/64, so integers are exact.
pub fn shrink(from: &[u8; FULL * FULL], to: &mut [u8; SIDE * SIDE]) {
    let (rows, _) = from.as_chunks::<FULL>();
    for (row, line) in to.as_chunks_mut::<SIDE>().0.iter_mut().enumerate() {
        let (block, part) = (row / 7, row % 7);
        let sums = shrink_rows(&rows[8 * block + part], &rows[8 * block + part + 1], part);
        let levels = shrink_columns(&sums);
        for (seven, eight) in line.as_chunks_mut::<7>().0.iter_mut().zip(levels.as_chunks::<8>().0) {
            seven.copy_from_slice(&eight[..7]);
        }
    }
}

/// Combines two rows, in eighths; one more column than the image has.
fn shrink_rows(upper: &[u8; FULL], lower: &[u8; FULL], part: usize) -> [u16; FULL + 1] {
    let (first, second) = (FIRST[part], SECOND[part]);
    let mut sums = [0; FULL + 1];
    for (sum, (a, b)) in sums.iter_mut().zip(upper.iter().zip(lower)) {
        *sum = first * u16::from(*a) + second * u16::from(*b);
    }
    sums
}

/// Combines each column with its right neighbour, rounded; every eighth is unused.
fn shrink_columns(sums: &[u16; FULL + 1]) -> [u8; FULL] {
    let mut levels = [0; FULL];
    for (column, level) in levels.iter_mut().enumerate() {
        let sum = FIRSTS[column] * sums[column] + SECONDS[column] * sums[column + 1];
        *level = ((sum + 31 + ((sum >> 6) & 1)) >> 6) as u8;
    }
    levels
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    /// The definition: the mean over the output pixel's square, of 8/7 input pixels a side.
    fn mean(from: &[u8], row: usize, column: usize) -> f64 {
        let overlap = |input: usize, output: usize| {
            let (low, high) = (output as f64 * 8.0 / 7.0, (output + 1) as f64 * 8.0 / 7.0);
            (high.min(input as f64 + 1.0) - low.max(input as f64)).max(0.0)
        };
        let mut sum = 0.0;
        for y in row..FULL.min(row + row / 7 + 3) {
            for x in column..FULL.min(column + column / 7 + 3) {
                sum += overlap(y, row) * overlap(x, column) * f64::from(from[y * FULL + x]);
            }
        }
        sum * 49.0 / 64.0
    }

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(8))]
        #[test]
        fn every_pixel_is_the_mean_of_its_area(seed in prop::collection::vec(any::<u8>(), 97)) {
            let from: [u8; FULL * FULL] = std::array::from_fn(|i| seed[i * 31 % 97] ^ (i / 97) as u8);
            let mut to = [0; SIDE * SIDE];
            shrink(&from, &mut to);
            for (i, level) in to.iter().enumerate() {
                let wanted = mean(&from, i / SIDE, i % SIDE);
                prop_assert!((f64::from(*level) - wanted).abs() <= 0.5 + 1e-9, "{} {} {}", i, level, wanted);
            }
        }
    }

    #[test]
    fn ties_go_to_the_even_level() {
        // Output 3 averages inputs 3 and 4 half and half in both directions.
        let mut from = [0u8; FULL * FULL];
        let mut to = [0; SIDE * SIDE];
        for (sum, wanted) in [(2u8, 0), (6, 2), (10, 2), (4, 1)] {
            from[3 * FULL + 3] = sum;
            shrink(&from, &mut to);
            assert_eq!(to[3 * SIDE + 3], wanted, "{sum} / 4");
        }
    }

    #[test]
    fn grey_is_rounded_luma() {
        let mut levels = [0; 4];
        to_grey(&[255, 255, 255, 102, 204, 102, 255, 0, 0, 0, 0, 255], &mut levels);
        assert_eq!(levels, [255, 162, 76, 29]);
    }
}
