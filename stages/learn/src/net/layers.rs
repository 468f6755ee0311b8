//! The layers that the thesis's networks are made of, and the builder that names their parameters.

use dril_stage_api::StreamRng;
use tch::Tensor;

use super::{Init, ParamId, ParamSpec, Parameters};
use crate::fast::layout;

/// What follows a layer's sum.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Activation {
    /// Nothing.
    Linear,
    /// max(x, 0).
    Relu,
    /// The hyperbolic tangent.
    Tanh,
}

impl Activation {
    fn apply(self, x: Tensor) -> Tensor {
        match self {
            Self::Linear => x,
            Self::Relu => x.relu(),
            Self::Tanh => x.tanh(),
        }
    }
}

/// How the weights and biases of a layer begin.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum LayerInit {
    /// PyTorch's default for weight and bias.
    Default,
    /// Orthogonal weights with this gain, zero bias.
    Orthogonal(f32),
}

/// One layer.
#[derive(Clone, Debug, PartialEq)]
enum Layer {
    /// The first convolution (8×8, stride 4), fed with frames in blocks and in bytes' units (see [`layout`]).
    Pixels {
        weight: ParamId,
        bias: ParamId,
    },
    Conv {
        weight: ParamId,
        bias: ParamId,
        stride: i64,
    },
    Flatten,
    Linear {
        weight: ParamId,
        bias: ParamId,
        activation: Activation,
    },
}

/// Layers one after the other.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Sequential(Vec<Layer>);

impl Sequential {
    /// The output for a batch of inputs.
    pub fn forward(&self, params: &Parameters, input: &Tensor) -> Tensor {
        let mut x = input.shallow_clone();
        for layer in &self.0 {
            x = layer.forward(params, &x);
        }
        x
    }
}

impl Layer {
    /// Each layer takes its input in the kind of its weights.
    fn forward(&self, params: &Parameters, x: &Tensor) -> Tensor {
        match *self {
            Self::Pixels { weight, bias } => {
                // Few numbers, scaled before they are rounded: the kernel and not the parameter is made short.
                let bias = params.weight(bias);
                let kernel = layout::block_kernel(params.tensor(weight)).to_kind(bias.kind());
                x.to_kind(bias.kind()).conv2d(&kernel, Some(bias), 1, 0, 1, 1).relu()
            }
            Self::Conv { weight, bias, stride } => {
                let weight = params.weight(weight);
                x.to_kind(weight.kind()).conv2d(weight, Some(params.weight(bias)), stride, 0, 1, 1).relu()
            }
            Self::Flatten => x.flatten(1, -1),
            Self::Linear { weight, bias, activation } => {
                let weight = params.weight(weight);
                activation.apply(x.to_kind(weight.kind()).linear(weight, Some(params.weight(bias))))
            }
        }
    }
}

/// Collects the parameters of a network while its layers are described.
#[derive(Debug, Default)]
pub struct Builder {
    specs: Vec<ParamSpec>,
}

/// Layers with fewer outputs than this are never rounded (see [`ParamSpec::may_round`]).
const NARROW: usize = 32;

/// The kernel size and stride of the three convolutions of Mnih et al. (2015).
const CONVOLUTIONS: [(i64, i64); 3] = [(8, 4), (4, 2), (3, 1)];

impl Builder {
    /// Nothing described yet.
    pub fn new() -> Self {
        Self::default()
    }

    /// A parameter that belongs to no layer.
    pub fn param(&mut self, name: impl Into<String>, shape: &[i64], init: Init) -> ParamId {
        self.specs.push(ParamSpec { name: name.into(), shape: shape.to_vec(), init, may_round: false });
        ParamId(self.specs.len() - 1)
    }

    /// A fully connected layer, appended to `to`.
    pub fn linear(
        &mut self,
        to: &mut Sequential,
        name: &str,
        (inputs, outputs): (usize, usize),
        init: LayerInit,
        activation: Activation,
    ) {
        let (weight, bias) = self.weight_and_bias(name, &[outputs as i64, inputs as i64], init);
        // What says the action or the value is not rounded: it costs nothing there.
        if outputs >= NARROW {
            self.may_round([weight, bias]);
        }
        to.0.push(Layer::Linear { weight, bias, activation });
    }

    /// The three convolutions with ReLU of Mnih et al. (2015), flattened, for a stack of frames of `stack`×`height`×
    /// `width`; gives them with the number of features that come out.
    pub fn convolutions(
        &mut self,
        name: &str,
        (stack, height, width): (usize, usize, usize),
        filters: [usize; 3],
        init: LayerInit,
    ) -> (Sequential, usize) {
        let mut layers = Vec::new();
        let (mut channels, mut height, mut width) = (stack, height, width);
        for (index, ((kernel, stride), filters)) in CONVOLUTIONS.into_iter().zip(filters).enumerate() {
            let shape = [filters as i64, channels as i64, kernel, kernel];
            let (weight, bias) = self.weight_and_bias(&format!("{name}.{index}"), &shape, init);
            layers.push(match index {
                0 => {
                    self.may_round([bias]);
                    Layer::Pixels { weight, bias }
                }
                _ => {
                    self.may_round([weight, bias]);
                    Layer::Conv { weight, bias, stride }
                }
            });
            channels = filters;
            height = (height - kernel as usize) / stride as usize + 1;
            width = (width - kernel as usize) / stride as usize + 1;
        }
        layers.push(Layer::Flatten);
        (Sequential(layers), channels * height * width)
    }

    /// The parameters, with first values from the stream.
    pub fn finish(self, stream: &mut StreamRng) -> Parameters {
        Parameters::new(self.specs, Some(stream))
    }

    /// The parameters as zeros, to be replaced by [`super::weights::Weights::fill`].
    pub fn finish_blank(self) -> Parameters {
        Parameters::new(self.specs, None)
    }

    fn may_round<const N: usize>(&mut self, ids: [ParamId; N]) {
        ids.into_iter().for_each(|id| self.specs[id.0].may_round = true);
    }

    fn weight_and_bias(&mut self, name: &str, shape: &[i64], init: LayerInit) -> (ParamId, ParamId) {
        let fan_in = shape[1..].iter().product::<i64>() as usize;
        let (weight, bias) = match init {
            LayerInit::Default => (Init::FanIn(fan_in), Init::FanIn(fan_in)),
            LayerInit::Orthogonal(gain) => (Init::Orthogonal(gain), Init::Constant(0.0)),
        };
        let weight = self.param(format!("{name}.weight"), shape, weight);
        let bias = self.param(format!("{name}.bias"), &shape[..1], bias);
        (weight, bias)
    }
}
