//! The layers that the networks are made of, and the builder that names their parameters.

use dril_stage_api::StreamRng;

use super::convolution::Convolution;
use super::graph::{Graph, NodeId};
use super::{Init, ParamId, ParamSpec, Parameters};
use crate::kernels::{conv, dense};

/// The function applied to a layer's sums.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Activation {
    /// None.
    Linear,
    /// max(x, 0).
    Relu,
    /// The hyperbolic tangent.
    Tanh,
}

/// The initial weights and biases of a layer.
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
    /// Images with their channels last as rows of numbers, one channel after the other (PyTorch's order).
    Flatten { pixels: usize, channels: usize },
    /// A fully connected layer.
    Linear { weight: ParamId, bias: ParamId, shape: dense::Shape, activation: Activation },
}

impl Layer {
    /// Numbers in a row of its output.
    pub(super) fn output_len(&self) -> usize {
        match self {
            Self::Conv { conv, .. } => conv.shape.output_len(),
            Self::Flatten { pixels, channels } => pixels * channels,
            Self::Linear { shape, .. } => shape.outputs,
        }
    }

    /// Numbers in a row of its input.
    pub(super) fn input_len(&self) -> usize {
        match self {
            Self::Conv { conv, .. } => conv.shape.input_len(),
            Self::Flatten { pixels, channels } => pixels * channels,
            Self::Linear { shape, .. } => shape.inputs,
        }
    }
}

/// Layers one after the other.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Sequential(pub(super) Vec<Layer>);

/// Collects the parameters and the graph of a network while its layers are described.
#[derive(Debug, Default)]
pub struct Builder {
    specs: Vec<ParamSpec>,
    graph: Graph,
}

/// The kernel size and stride of the three convolutions of Mnih et al. (2015).
const CONVOLUTIONS: [(usize, usize); 3] = [(8, 4), (4, 2), (3, 1)];

impl Builder {
    /// Nothing described yet.
    pub fn new() -> Self {
        Self::default()
    }

    /// A parameter that belongs to no layer.
    pub fn param(&mut self, name: impl Into<String>, shape: &[usize], init: Init) -> ParamId {
        self.specs.push(ParamSpec { name: name.into(), shape: shape.to_vec(), init });
        ParamId(self.specs.len() - 1)
    }

    /// A part of the network that computes these layers from another part, or from the observations.
    pub fn node(&mut self, source: Option<NodeId>, layers: Sequential) -> NodeId {
        self.graph.push(source, layers)
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
        let (weight, bias) = self.weight_and_bias(name, &[outputs, inputs], init);
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
            let size = [filters, channels, kernel, kernel];
            let (weight, bias) = self.weight_and_bias(&format!("{name}.{index}"), &size, init);
            let shape = conv::Shape { height, width, channels, filters, kernel, stride };
            let conv = if index == 0 { Convolution::blocked(shape) } else { Convolution::new(shape) };
            (height, width) = shape.output();
            channels = filters;
            layers.push(Layer::Conv { weight, bias, conv });
        }
        layers.push(Layer::Flatten { pixels: height * width, channels });
        (Sequential(layers), channels * height * width)
    }

    /// The network's graph and its parameters, with first values from the stream, or zeros without one (to be replaced
    /// by [`super::weights::Weights::fill`]).
    pub fn finish(self, stream: Option<&mut StreamRng>) -> (Graph, Parameters) {
        (self.graph, Parameters::new(self.specs, stream))
    }

    fn weight_and_bias(&mut self, name: &str, shape: &[usize], init: LayerInit) -> (ParamId, ParamId) {
        let fan_in = shape[1..].iter().product::<usize>();
        let (weight, bias) = match init {
            LayerInit::Default => (Init::FanIn(fan_in), Init::FanIn(fan_in)),
            LayerInit::Orthogonal(gain) => (Init::Orthogonal(gain), Init::Constant(0.0)),
        };
        let weight = self.param(format!("{name}.weight"), shape, weight);
        let bias = self.param(format!("{name}.bias"), &shape[..1], bias);
        (weight, bias)
    }
}
