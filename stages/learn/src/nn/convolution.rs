//! A convolution layer: converts between PyTorch's layout of weights and the panels of the kernels.

use crate::kernels::{conv, layout};

/// A convolution with ReLU.
#[derive(Clone, Debug, PartialEq)]
pub struct Convolution {
    /// As the kernels see it.
    pub shape: conv::Shape,
    /// For each number of a window, the index of its weight within a filter, [channels, kernel, kernel].
    places: Vec<u32>,
    /// Factor on the weights.
    scale: f32,
}

impl Convolution {
    /// A convolution over images with the channels last.
    pub fn new(shape: conv::Shape) -> Self {
        let conv::Shape { channels, kernel, .. } = shape;
        let place = |at: usize| {
            let (pixel, channel) = (at / channels, at % channels);
            (channel * kernel * kernel + pixel) as u32
        };
        Self { shape, places: (0..shape.depth()).map(place).collect(), scale: 1.0 }
    }

    /// The first convolution, over stacks of frames in bytes' units: the same function over frames in blocks of 4×4,
    /// with weights divided by 255 (see [`layout`]). `shape` is that over pixels, its stride the side of a block.
    pub fn blocked(shape: conv::Shape) -> Self {
        const BLOCK: usize = layout::BLOCK;
        let conv::Shape { channels: stack, kernel, .. } = shape;
        let blocks = kernel / BLOCK;
        let blocked = conv::Shape {
            height: shape.height / BLOCK,
            width: shape.width / BLOCK,
            channels: stack * BLOCK * BLOCK,
            kernel: blocks,
            stride: 1,
            ..shape
        };
        let place = |at: usize| {
            let (block, within) = (at / blocked.channels, at % blocked.channels);
            let (frame, pixel) = (within / (BLOCK * BLOCK), within % (BLOCK * BLOCK));
            let (y, x) = (block / blocks * BLOCK + pixel / BLOCK, block % blocks * BLOCK + pixel % BLOCK);
            ((frame * kernel + y) * kernel + x) as u32
        };
        Self { shape: blocked, places: (0..blocked.depth()).map(place).collect(), scale: 1.0 / 255.0 }
    }

    /// True for [`Convolution::blocked`].
    pub fn is_blocked(&self) -> bool {
        self.scale != 1.0
    }

    /// The weights for [`conv::forward`].
    pub fn panels(&self, weights: &[f32], panels: &mut [f32]) {
        conv::panels(&self.shape, |filter, place| self.weight(weights, filter, place), panels);
    }

    /// The weights for [`conv::input_gradient`].
    pub fn transposed_panels(&self, weights: &[f32], panels: &mut [f32]) {
        conv::transposed_panels(&self.shape, |filter, place| self.weight(weights, filter, place), panels);
    }

    /// The gradient of the weights out of the panels of [`conv::add_weight_gradient`].
    pub fn read_panels(&self, panels: &[f32], gradient: &mut [f32]) {
        let depth = self.shape.depth();
        conv::read_panels(&self.shape, panels, |filter, place, sum| {
            gradient[filter * depth + self.places[place] as usize] = sum * self.scale;
        });
    }

    fn weight(&self, weights: &[f32], filter: usize, place: usize) -> f32 {
        weights[filter * self.shape.depth() + self.places[place] as usize] * self.scale
    }
}
