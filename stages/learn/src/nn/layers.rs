//! The layers of a network.

use super::ParamId;
use super::convolution::Convolution;
use crate::kernels::dense;

/// Activation function.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Activation {
    /// None.
    Linear,
    /// max(x, 0).
    Relu,
    /// The hyperbolic tangent.
    Tanh,
}

/// Initialisation of a layer's weights and biases.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum LayerInit {
    /// PyTorch's default for weight and bias.
    Default,
    /// Orthogonal weights with this gain, zero bias.
    Orthogonal(f32),
}

/// One layer.
#[derive(Clone, Debug, PartialEq)]
pub(super) enum Layer {
    /// A convolution with ReLU.
    Conv { weight: ParamId, bias: ParamId, conv: Convolution },
    /// Flattens channels-last images, one channel after the other (PyTorch's order).
    Flatten { pixels: usize, channels: usize },
    /// A fully connected layer.
    Linear { weight: ParamId, bias: ParamId, shape: dense::Shape, activation: Activation },
}

impl Layer {
    /// Length of an output row.
    pub(super) fn output_len(&self) -> usize {
        match self {
            Self::Conv { conv, .. } => conv.shape.output_len(),
            Self::Flatten { pixels, channels } => pixels * channels,
            Self::Linear { shape, .. } => shape.outputs,
        }
    }

    /// Length of an input row.
    pub(super) fn input_len(&self) -> usize {
        match self {
            Self::Conv { conv, .. } => conv.shape.input_len(),
            Self::Flatten { pixels, channels } => pixels * channels,
            Self::Linear { shape, .. } => shape.inputs,
        }
    }
}

/// A sequence of layers.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Sequential(pub(super) Vec<Layer>);
