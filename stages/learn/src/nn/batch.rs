//! A batch of observations, the input of a network.

/// Observations, one row each.
#[derive(Clone, Debug, PartialEq)]
pub enum Batch {
    /// Stacks of frames as bytes in blocks of 4×4 pixels (see [`crate::kernels::layout`]):
    /// [rows, height / 4, width / 4, stack · 16].
    Images {
        /// Number of observations.
        rows: usize,
        /// Their bytes, 0..=255.
        bytes: Vec<u8>,
    },
    /// Vectors: [rows, len].
    Vectors {
        /// Number of observations.
        rows: usize,
        /// Their numbers.
        numbers: Vec<f32>,
    },
}

impl Batch {
    /// Number of observations.
    pub fn rows(&self) -> usize {
        match self {
            Self::Images { rows, .. } | Self::Vectors { rows, .. } => *rows,
        }
    }

    /// The batch as the input of a layer.
    pub(super) fn input(&self) -> Input<'_> {
        match self {
            Self::Images { bytes, .. } => Input::Bytes(bytes),
            Self::Vectors { numbers, .. } => Input::Numbers(numbers),
        }
    }
}

/// The input of a layer, row by row.
#[derive(Clone, Copy, Debug)]
pub(super) enum Input<'a> {
    /// Images of bytes: the first convolution only.
    Bytes(&'a [u8]),
    /// Everything else.
    Numbers(&'a [f32]),
}

impl<'a> Input<'a> {
    /// The rows in a range, of `rows` in all.
    pub(super) fn rows(self, range: &std::ops::Range<usize>, rows: usize) -> Self {
        match self {
            Self::Bytes(bytes) => {
                let len = bytes.len() / rows.max(1);
                Self::Bytes(&bytes[range.start * len..range.end * len])
            }
            Self::Numbers(numbers) => {
                let len = numbers.len() / rows.max(1);
                Self::Numbers(&numbers[range.start * len..range.end * len])
            }
        }
    }

    /// The numbers; empty if the input is bytes.
    pub(super) fn numbers(self) -> &'a [f32] {
        match self {
            Self::Bytes(_) => &[],
            Self::Numbers(numbers) => numbers,
        }
    }
}
