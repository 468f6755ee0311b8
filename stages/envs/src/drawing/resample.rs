//! Resampling of images by area averaging, for any pair of sizes.
//!
//! For the one size that the thesis uses, [`crate::wrappers::preprocess::shrink`] is exact and faster.

/// Resamples images of one size to another.
#[derive(Clone, Debug, PartialEq)]
pub struct AreaResampler {
    /// Rows and columns of the input.
    from: [usize; 2],
    /// For each output row, and for each output column: the first input, and the weights from there on, with sum 1.
    axes: [Vec<(usize, Vec<f32>)>; 2],
    /// Weighted sum of input rows, one output row.
    line: Vec<f32>,
}

impl AreaResampler {
    /// A resampler from `from` rows and columns to `to`.
    pub fn new(from: [usize; 2], to: [usize; 2]) -> Self {
        let axes = [0, 1].map(|axis| weights(from[axis], to[axis]));
        Self { from, axes, line: Vec::new() }
    }

    /// Rows and columns of the input.
    pub fn from(&self) -> [usize; 2] {
        self.from
    }

    /// Averages `from`, with `channels` bytes a pixel, into `to`; rounded to nearest. Slices of other sizes are filled
    /// as far as they go.
    pub fn apply(&mut self, from: &[u8], channels: usize, to: &mut [u8]) {
        let width = self.from[1] * channels;
        let [rows, columns] = &self.axes;
        self.line.resize(width, 0.0);
        for ((first, parts), out) in rows.iter().zip(to.chunks_exact_mut((columns.len() * channels).max(1))) {
            self.line.fill(0.0);
            for (row, part) in from.chunks_exact(width.max(1)).skip(*first).zip(parts) {
                for (sum, value) in self.line.iter_mut().zip(row) {
                    *sum += part * f32::from(*value);
                }
            }
            for ((first, parts), pixel) in columns.iter().zip(out.chunks_exact_mut(channels)) {
                for (channel, level) in pixel.iter_mut().enumerate() {
                    let values = self.line[first * channels..].iter().skip(channel).step_by(channels);
                    let sum: f32 = values.zip(parts).map(|(value, part)| value * part).sum();
                    *level = (sum + 0.5) as u8;
                }
            }
        }
    }
}

/// For each of `to` pixels the inputs that lie under it, with their shares.
fn weights(from: usize, to: usize) -> Vec<(usize, Vec<f32>)> {
    let step = from as f64 / to as f64;
    let share = |output: usize| {
        let (low, high) = (output as f64 * step, (output + 1) as f64 * step);
        let first = (low as usize).min(from.saturating_sub(1));
        let last = (high.ceil() as usize).clamp(first + 1, from.max(first + 1));
        let under = |input: usize| (high.min(input as f64 + 1.0) - low.max(input as f64)).max(0.0);
        let parts = (first..last).map(|input| (under(input) / step) as f32);
        (first, parts.collect())
    };
    (0..to).map(share).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::wrappers::preprocess::{self, FULL, SIDE};
    use proptest::prelude::*;

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(16))]
        #[test]
        fn one_level_everywhere_stays_that_level(h in 1..90usize, w in 1..90usize, level in 0..=255u8, c in 1..4usize) {
            let mut to = vec![0; SIDE * 60 * c];
            AreaResampler::new([h, w], [60, SIDE]).apply(&vec![level; h * w * c], c, &mut to);
            prop_assert!(to.iter().all(|&seen| seen == level));
        }
    }

    #[test]
    fn the_thesis_s_size_comes_out_as_by_the_exact_way() {
        let from: [u8; FULL * FULL] = std::array::from_fn(|i| (i * 37 % 251) as u8 ^ (i / 96) as u8);
        let (mut exact, mut ours) = ([0; SIDE * SIDE], vec![0; SIDE * SIDE]);
        preprocess::shrink(&from, &mut exact);
        AreaResampler::new([FULL; 2], [SIDE; 2]).apply(&from, 1, &mut ours);
        assert!(exact.iter().zip(&ours).all(|(a, b)| a.abs_diff(*b) <= 1));
        // Of the means here, 608 are ties: those go to the even level there and up here.
        let differ = exact.iter().zip(&ours).filter(|(a, b)| a != b).count();
        assert!(differ <= 608, "{differ} pixels differ");
    }

    #[test]
    fn channels_stay_apart_and_pixels_are_repeated_when_enlarged() {
        let mut to = vec![0; 2 * 4 * 3];
        AreaResampler::new([1, 2], [2, 4]).apply(&[10, 20, 30, 40, 50, 60], 3, &mut to);
        let row = [10, 20, 30, 10, 20, 30, 40, 50, 60, 40, 50, 60];
        assert_eq!(to, [row, row].concat());
    }
}
