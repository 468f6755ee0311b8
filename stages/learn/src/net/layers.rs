//! The layers that the thesis's networks are made of, and the builder that names their parameters.

use dril_stage_api::StreamRng;
use tch::Tensor;

use super::convolution::Convolution;
use super::{Init, ParamId, ParamSpec, Parameters};
use crate::fast::layout;
use crate::kernels::{conv, dense};

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
    fn torch(self, x: Tensor) -> Tensor {
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
pub(super) enum Layer {
    /// A convolution with ReLU.
    Conv {
        weight: ParamId,
        bias: ParamId,
        conv: Convolution,
    },
    /// Pictures as rows of numbers, one channel after the other.
    Flatten,
    Linear {
        weight: ParamId,
        bias: ParamId,
        shape: dense::Shape,
        activation: Activation,
    },
}

/// Layers one after the other.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Sequential(pub(super) Vec<Layer>);

impl Sequential {
    /// True where there is no layer.
    pub fn is_empty(&self) -> bool {
        self.0.is_empty()
    }

    /// The output for a batch of inputs, by libtorch and with its gradients: the way with 16 bits, and what
    /// [`Sequential::pass`] is held against.
    pub fn torch_forward(&self, params: &Parameters, input: &Tensor) -> Tensor {
        let mut x = input.shallow_clone();
        for layer in &self.0 {
            x = layer.torch_forward(params, &x);
        }
        x
    }
}

impl Layer {
    /// Each layer takes its input in the kind of its weights; pictures have their channels last.
    fn torch_forward(&self, params: &Parameters, x: &Tensor) -> Tensor {
        match self {
            Self::Conv { weight, bias, conv } => {
                let x = x.permute([0, 3, 1, 2]);
                let bias = params.weight(*bias);
                let (kernel, stride) = match conv.is_blocked() {
                    // Few numbers, scaled before they are rounded: the kernel and not the parameter is made short.
                    true => (layout::block_kernel(params.tensor(*weight)).to_kind(bias.kind()), 1),
                    false => (params.weight(*weight).shallow_clone(), conv.shape.stride as i64),
                };
                let sums = x.to_kind(bias.kind()).conv2d(&kernel, Some(bias), stride, 0, 1, 1);
                sums.relu().permute([0, 2, 3, 1])
            }
            Self::Flatten => x.permute([0, 3, 1, 2]).flatten(1, -1),
            Self::Linear { weight, bias, activation, .. } => {
                let weight = params.weight(*weight);
                activation.torch(x.to_kind(weight.kind()).linear(weight, Some(params.weight(*bias))))
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
        to.0.push(Layer::Linear { weight, bias, shape: dense::Shape { inputs, outputs }, activation });
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
            let size = [filters as i64, channels as i64, kernel, kernel];
            let (weight, bias) = self.weight_and_bias(&format!("{name}.{index}"), &size, init);
            let (kernel, stride) = (kernel as usize, stride as usize);
            let shape = conv::Shape { height, width, channels, filters, kernel, stride };
            let conv = if index == 0 { Convolution::blocked(shape) } else { Convolution::new(shape) };
            match index {
                0 => self.may_round([bias]),
                _ => self.may_round([weight, bias]),
            }
            (height, width) = shape.output();
            channels = filters;
            layers.push(Layer::Conv { weight, bias, conv });
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
