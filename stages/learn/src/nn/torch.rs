//! The libtorch backend: the same networks by libtorch's operations, with gradients by autograd.
//!
//! On the CPU it is what the tests hold the native backend against; with a libtorch that has CUDA it is what
//! `device: cuda` computes with. Parameters, losses and the optimizer stay with the host: what crosses over are
//! observations (as bytes), weights, outputs and gradients.

use std::cell::RefCell;

use tch::{Device, Kind, Tensor};

use super::graph::{Graph, Wanted};
use super::layers::{Activation, Layer};
use super::{Batch, Gradients, ParamId, Parameters};
use crate::kernels::layout::BLOCK;

/// Weights on the device, and the generation of [`Parameters`] that they are copies of.
#[derive(Debug)]
pub(super) struct Torch {
    device: Device,
    leaves: RefCell<(Option<u64>, Vec<Tensor>)>,
}

/// The outputs of a pass, as parts of libtorch's graph.
#[derive(Debug)]
pub(super) struct Tape(Vec<Option<Tensor>>);

impl Torch {
    /// On this device, which exists.
    pub(super) fn new(device: Device) -> Self {
        Self { device, leaves: RefCell::new((None, Vec::new())) }
    }

    /// Copies the weights to the device where they have changed since the last pass.
    fn refresh(&self, params: &Parameters) {
        let (generation, leaves) = &mut *self.leaves.borrow_mut();
        if *generation != Some(params.generation()) {
            *generation = Some(params.generation());
            *leaves = params.ids().map(|id| self.leaf(params, id)).collect();
        }
    }

    fn leaf(&self, params: &Parameters, id: ParamId) -> Tensor {
        let shape: Vec<i64> = params.spec(id).shape.iter().map(|&n| n as i64).collect();
        let tensor = Tensor::from_slice(params.slice(id)).view(&*shape);
        tensor.to_device(self.device).detach().set_requires_grad(true)
    }

    fn input(&self, batch: &Batch, graph: &Graph) -> Tensor {
        match batch {
            Batch::Vectors { rows, numbers } => {
                Tensor::from_slice(numbers).view([*rows as i64, -1]).to_device(self.device)
            }
            Batch::Images { rows, bytes } => {
                let shape = graph.nodes.iter().find_map(|node| match node.layers.0.first() {
                    Some(Layer::Conv { conv, .. }) if node.source.is_none() => Some(conv.shape),
                    _ => None,
                });
                let (height, width) = shape.map_or((1, 1), |shape| (shape.height, shape.width));
                let bytes = Tensor::from_slice(bytes).to_device(self.device).to_kind(Kind::Float);
                bytes.view([*rows as i64, height as i64, width as i64, -1])
            }
        }
    }

    /// As [`super::native::forward`].
    pub(super) fn forward(
        &self,
        graph: &Graph,
        params: &Parameters,
        batch: &Batch,
        wanted: &[Wanted],
    ) -> (Vec<Vec<f32>>, Tape) {
        self.refresh(params);
        let leaves = &self.leaves.borrow().1;
        let (needed, input) = (graph.needed(wanted, batch.rows()), self.input(batch, graph));
        let mut outputs: Vec<Option<Tensor>> = Vec::with_capacity(graph.nodes.len());
        for (node, rows) in graph.nodes.iter().zip(needed) {
            let output = rows.map(|rows| {
                let source = node.source.and_then(|source| outputs[source].as_ref()).unwrap_or(&input);
                let source = source.narrow(0, rows.start as i64, rows.len() as i64);
                node.layers.0.iter().fold(source, |x, layer| layer.torch_forward(leaves, &x))
            });
            outputs.push(output);
        }
        let numbers = |wanted: &Wanted| outputs[wanted.node.0].as_ref().map(to_host).unwrap_or_default();
        (wanted.iter().map(numbers).collect(), Tape(outputs))
    }

    /// As [`super::native::backward`].
    pub(super) fn backward(
        &self,
        params: &Parameters,
        tape: &Tape,
        arrived: Vec<(Wanted, Vec<f32>)>,
        gradients: &mut Gradients,
    ) {
        let leaves = &self.leaves.borrow().1;
        // The gradient of Σ output · constant with respect to the output is the constant.
        let parts = arrived.iter().filter_map(|(wanted, gradient)| {
            let output = tape.0[wanted.node.0].as_ref()?;
            let gradient = Tensor::from_slice(gradient).view_as(output).to_device(self.device);
            Some((output * gradient).sum(Kind::Float))
        });
        let Some(loss) = parts.reduce(|sum, part| sum + part) else { return };
        let leaves: Vec<&Tensor> = leaves.iter().collect();
        let found = Tensor::run_backward(&[loss], &leaves, false, false);
        for (id, gradient) in params.ids().zip(found).filter(|(_, gradient)| gradient.defined()) {
            copy_to_host(&gradient, gradients.set(id));
        }
    }
}

impl Layer {
    fn torch_forward(&self, leaves: &[Tensor], x: &Tensor) -> Tensor {
        match self {
            Self::Conv { weight, bias, conv } => {
                let (kernel, stride) = match conv.is_blocked() {
                    true => (block_kernel(&leaves[weight.0]), 1),
                    false => (leaves[weight.0].shallow_clone(), conv.shape.stride as i64),
                };
                let sums = x.permute([0, 3, 1, 2]).conv2d(&kernel, Some(&leaves[bias.0]), stride, 0, 1, 1);
                sums.relu().permute([0, 2, 3, 1])
            }
            Self::Flatten { .. } => x.permute([0, 3, 1, 2]).flatten(1, -1),
            Self::Linear { weight, bias, activation, .. } => {
                let sums = x.linear(&leaves[weight.0], Some(&leaves[bias.0]));
                match activation {
                    Activation::Linear => sums,
                    Activation::Relu => sums.relu(),
                    Activation::Tanh => sums.tanh(),
                }
            }
        }
    }
}

/// The kernel `[filters, channels, 8, 8]` for inputs in 0..1 as the kernel `[filters, channels·16, 2, 2]` for blocks of
/// bytes (see [`crate::kernels::layout`]).
fn block_kernel(kernel: &Tensor) -> Tensor {
    let size = kernel.size();
    let (filters, channels, block) = (size[0], size[1], BLOCK as i64);
    let (rows, columns) = (size[2] / block, size[3] / block);
    let blocks = kernel.view([filters, channels, rows, block, columns, block]).permute([0, 1, 3, 5, 2, 4]);
    blocks.reshape([filters, channels * block * block, rows, columns]) * (1.0 / 255.0)
}

fn to_host(tensor: &Tensor) -> Vec<f32> {
    let mut numbers = vec![0.0; tensor.numel()];
    copy_to_host(tensor, &mut numbers);
    numbers
}

/// `to` has as many numbers as the tensor.
fn copy_to_host(tensor: &Tensor, to: &mut [f32]) {
    let dense = tensor.detach().to_device(Device::Cpu).to_kind(Kind::Float).contiguous();
    dense.copy_data(to, tensor.numel());
}
