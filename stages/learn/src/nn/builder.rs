//! The builder of a network: describes its layers and names their parameters.

use dril_stage_api::StreamRng;

use super::convolution::Convolution;
use super::graph::{Graph, NodeId};
use super::layers::{Activation, Layer, LayerInit, Sequential};
use super::{Init, ParamId, ParamSpec, Parameters};
use crate::kernels::{conv, dense};

/// Collects the parameters and the graph of a network.
#[derive(Debug, Default)]
pub struct Builder {
    specs: Vec<ParamSpec>,
    graph: Graph,
}

/// The kernel size and stride of the three convolutions of Mnih et al. (2015).
const CONVOLUTIONS: [(usize, usize); 3] = [(8, 4), (4, 2), (3, 1)];

impl Builder {
    /// An empty network.
    pub fn new() -> Self {
        Self::default()
    }

    /// Adds a parameter that belongs to no layer.
    pub fn param(&mut self, name: impl Into<String>, shape: &[usize], init: Init) -> ParamId {
        self.specs.push(ParamSpec { name: name.into(), shape: shape.to_vec(), init });
        ParamId(self.specs.len() - 1)
    }

    /// Adds a node that applies these layers to another node's output, or to the observations.
    pub fn node(&mut self, source: Option<NodeId>, layers: Sequential) -> NodeId {
        self.graph.push(source, layers)
    }

    /// Appends a fully connected layer to `to`.
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
    /// `width`; returns them with the number of output features.
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

    /// The network's graph and parameters, initialised from the stream, or with zeros if there is none (to be replaced
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
