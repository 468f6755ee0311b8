//! The way through a network and back with the kernels of [`crate::kernels`]: what learning with 32 bits does.
//!
//! libtorch's own graph ends where a network ends: it computes losses, and its gradients arrive here.

use tch::{Device, Kind, Tensor};

use super::convolution::Convolution;
use super::layers::{Activation, Layer, Sequential};
use super::{ParamId, Parameters};
use crate::fast::memory;
use crate::kernels::{activation, conv, dense};

/// What a batch left behind on its way through the layers of a [`Sequential`].
#[derive(Debug)]
pub struct Pass {
    input: Tensor,
    /// One for each layer.
    outputs: Vec<Tensor>,
}

impl Pass {
    /// What came out.
    pub fn output(&self) -> &Tensor {
        self.outputs.last().unwrap_or(&self.input)
    }

    fn before(&self, layer: usize) -> &Tensor {
        if layer == 0 { &self.input } else { &self.outputs[layer - 1] }
    }
}

/// One gradient for each parameter of a network; `None` where the loss does not depend on it.
#[derive(Debug)]
pub struct ByParameter(Vec<Option<Tensor>>);

impl ByParameter {
    /// None yet.
    pub fn new(params: &Parameters) -> Self {
        Self((0..params.len()).map(|_| None).collect())
    }

    /// Sets the gradient of a parameter, or adds to it.
    pub fn add(&mut self, id: ParamId, gradient: Tensor) {
        let slot = &mut self.0[id.0];
        *slot = Some(match slot.take() {
            Some(sum) => sum + gradient,
            None => gradient,
        });
    }

    /// Those of the parameters asked for, in that order.
    pub fn pick(mut self, ids: &[ParamId]) -> Vec<Option<Tensor>> {
        ids.iter().map(|id| self.0[id.0].take()).collect()
    }
}

impl Sequential {
    /// Sends a batch through the layers: pictures [batch, height, width, channels] or rows [batch, numbers], dense and
    /// with 32 bits; pictures for the first convolution may also be bytes. No graph of libtorch is made.
    pub fn pass(&self, params: &Parameters, input: &Tensor) -> Pass {
        let mut pass = Pass { input: input.detach(), outputs: Vec::with_capacity(self.0.len()) };
        for layer in &self.0 {
            pass.outputs.push(layer.forward(params, pass.output()));
        }
        pass
    }

    /// Sends the gradient of the output back, adds those of the weights to `gradients` and, where it is wanted, gives
    /// that of the input. `gradient` is dense and used up: its memory is written to.
    pub fn back(
        &self,
        params: &Parameters,
        pass: &Pass,
        gradient: Tensor,
        gradients: &mut ByParameter,
        wants_input: bool,
    ) -> Option<Tensor> {
        let mut gradient = gradient;
        for (index, layer) in self.0.iter().enumerate().rev() {
            let (input, output) = (pass.before(index), &pass.outputs[index]);
            let wanted = wants_input || index > 0;
            gradient = layer.back(params, (input, output), gradient, gradients, wanted)?;
        }
        wants_input.then_some(gradient)
    }
}

impl Layer {
    fn forward(&self, params: &Parameters, input: &Tensor) -> Tensor {
        let batch = input.size()[0];
        match self {
            Self::Conv { weight, bias, conv } => {
                let (height, width) = conv.shape.output();
                let mut output = empty(&[batch, height as i64, width as i64, conv.shape.filters as i64]);
                let panels = params.panels(*weight, conv.shape.weights_len(), |weights, panels| {
                    conv.panels(weights, panels);
                });
                let (bias, numbers) = (params.slice(*bias), memory::values_mut(&mut output));
                match input.kind() {
                    Kind::Uint8 => {
                        conv::forward_bytes(&conv.shape, memory::bytes(input), &panels, bias, numbers);
                    }
                    _ => conv::forward(&conv.shape, memory::values(input), &panels, bias, numbers),
                }
                output
            }
            Self::Flatten => input.permute([0, 3, 1, 2]).flatten(1, -1).contiguous(),
            Self::Linear { weight, bias, shape, activation } => {
                let mut output = empty(&[batch, shape.outputs as i64]);
                let panels = params.panels(*weight, shape.panels_len(), |weights, panels| {
                    dense::panels(*shape, weights, panels);
                });
                let numbers = memory::values_mut(&mut output);
                dense::forward(*shape, memory::values(input), &panels, params.slice(*bias), numbers);
                activation.apply(numbers);
                output
            }
        }
    }

    fn back(
        &self,
        params: &Parameters,
        (input, output): (&Tensor, &Tensor),
        mut gradient: Tensor,
        gradients: &mut ByParameter,
        wants_input: bool,
    ) -> Option<Tensor> {
        match self {
            Self::Conv { weight, bias, conv } => {
                activation::relu_gradient(memory::values(output), memory::values_mut(&mut gradient));
                gradients.add(*bias, column_sums(&gradient, conv.shape.filters));
                gradients.add(*weight, weight_gradient(conv, params, *weight, input, &gradient));
                wants_input.then(|| {
                    let panels =
                        params.transposed_panels(*weight, conv.shape.weights_len(), |weights, panels| {
                            conv.transposed_panels(weights, panels);
                        });
                    let mut back = empty(&input.size());
                    let numbers = memory::values_mut(&mut back);
                    conv::input_gradient(&conv.shape, memory::values(&gradient), &panels, numbers);
                    back
                })
            }
            Self::Flatten => {
                let size = input.size();
                let planes = gradient.view([size[0], size[3], size[1], size[2]]);
                Some(planes.permute([0, 2, 3, 1]).contiguous())
            }
            Self::Linear { weight, bias, shape, activation } => {
                activation.turn_back(memory::values(output), memory::values_mut(&mut gradient));
                gradients.add(*bias, column_sums(&gradient, shape.outputs));
                let mut sums = empty(&[shape.outputs as i64, shape.inputs as i64]);
                let (seen, gone) = (memory::values(input), memory::values(&gradient));
                dense::weight_gradient(*shape, seen, gone, memory::values_mut(&mut sums));
                gradients.add(*weight, sums);
                wants_input.then(|| {
                    let mut back = empty(&input.size());
                    dense::input_gradient(*shape, gone, params.slice(*weight), memory::values_mut(&mut back));
                    back
                })
            }
        }
    }
}

impl Activation {
    fn apply(self, numbers: &mut [f32]) {
        match self {
            Self::Linear => {}
            Self::Relu => activation::relu(numbers),
            Self::Tanh => activation::tanh(numbers),
        }
    }

    fn turn_back(self, output: &[f32], gradient: &mut [f32]) {
        match self {
            Self::Linear => {}
            Self::Relu => activation::relu_gradient(output, gradient),
            Self::Tanh => activation::tanh_gradient(output, gradient),
        }
    }
}

fn weight_gradient(
    conv: &Convolution,
    params: &Parameters,
    weight: ParamId,
    input: &Tensor,
    gradient: &Tensor,
) -> Tensor {
    let mut panels = vec![0.0; conv.shape.weights_len()];
    let gone = memory::values(gradient);
    match input.kind() {
        Kind::Uint8 => {
            conv::add_weight_gradient_bytes(&conv.shape, memory::bytes(input), gone, &mut panels);
        }
        _ => conv::add_weight_gradient(&conv.shape, memory::values(input), gone, &mut panels),
    }
    let mut sums = empty(&params.spec(weight).shape);
    conv.read_panels(&panels, memory::values_mut(&mut sums));
    sums
}

fn column_sums(rows: &Tensor, columns: usize) -> Tensor {
    let mut sums = empty(&[columns as i64]);
    activation::sum_rows(memory::values(rows), memory::values_mut(&mut sums));
    sums
}

/// A tensor to be written over.
fn empty(size: &[i64]) -> Tensor {
    Tensor::empty(size, (Kind::Float, Device::Cpu))
}

#[cfg(test)]
#[path = "pass_tests.rs"]
mod tests;
