//! The native backend: forward and backward pass with the kernels of [`crate::kernels`].

use std::cell::RefCell;
use std::collections::BTreeMap;
use std::ops::Range;

use super::batch::Input;
use super::convolution::Convolution;
use super::graph::{Graph, Wanted};
use super::layers::{Activation, Layer};
use super::{Batch, Gradients, ParamId, Parameters};
use crate::kernels::{Buffer, activation, conv, dense};

/// The outputs of all layers in a forward pass, for the backward pass.
#[derive(Debug)]
pub(super) struct Tape {
    rows: usize,
    /// None for a node that was not computed.
    nodes: Vec<Option<NodeOutputs>>,
}

#[derive(Debug)]
struct NodeOutputs {
    /// The rows of the batch that it was computed for.
    rows: Range<usize>,
    /// One for each layer.
    outputs: Vec<Buffer>,
}

impl Tape {
    /// The output of a node.
    fn output(&self, node: usize) -> &[f32] {
        self.nodes[node].as_ref().and_then(|ran| ran.outputs.last()).map_or(&[], |output| output)
    }

    /// The input of a node.
    fn input<'a>(&'a self, graph: &Graph, batch: &'a Batch, node: usize, rows: &Range<usize>) -> Input<'a> {
        let whole = match graph.nodes[node].source {
            None => batch.input(),
            Some(source) => Input::Numbers(self.output(source)),
        };
        whole.rows(rows, self.rows)
    }
}

/// Buffers of previous passes, by length: every training step needs the same ones, and clearing new memory would cost as
/// much as a layer.
#[derive(Debug, Default)]
pub(super) struct Pool(RefCell<BTreeMap<usize, Vec<Buffer>>>);

impl Pool {
    /// A buffer of that length with arbitrary contents.
    fn take(&self, len: usize) -> Buffer {
        self.0.borrow_mut().get_mut(&len).and_then(Vec::pop).unwrap_or_else(|| Buffer::zeros(len))
    }

    fn give(&self, buffer: Buffer) {
        self.0.borrow_mut().entry(buffer.len()).or_default().push(buffer);
    }

    /// Returns the buffers of a tape to the pool.
    pub(super) fn recycle(&self, tape: Tape) {
        tape.nodes.into_iter().flatten().flat_map(|ran| ran.outputs).for_each(|buffer| self.give(buffer));
    }
}

/// Forward pass through the nodes that are needed; returns the requested outputs, in that order, row-major.
pub(super) fn forward(
    graph: &Graph,
    params: &Parameters,
    pool: &Pool,
    batch: &Batch,
    wanted: &[Wanted],
) -> (Vec<Vec<f32>>, Tape) {
    let needed = graph.needed(wanted, batch.rows());
    let mut tape = Tape { rows: batch.rows(), nodes: graph.nodes.iter().map(|_| None).collect() };
    for (node, rows) in needed.into_iter().enumerate() {
        let Some(rows) = rows else { continue };
        let mut outputs: Vec<Buffer> = Vec::with_capacity(graph.nodes[node].layers.0.len());
        for layer in &graph.nodes[node].layers.0 {
            let mut output = pool.take(rows.len() * layer.output_len());
            let input = match outputs.last() {
                Some(last) => Input::Numbers(last),
                None => tape.input(graph, batch, node, &rows),
            };
            layer.forward(params, input, &mut output);
            outputs.push(output);
        }
        tape.nodes[node] = Some(NodeOutputs { rows, outputs });
    }
    let outputs = wanted.iter().map(|wanted| tape.output(wanted.node.0).to_vec()).collect();
    (outputs, tape)
}

/// Backward pass: writes the gradients of the parameters, given those of the outputs. Consumes the tape.
pub(super) fn backward(
    graph: &Graph,
    params: &Parameters,
    pool: &Pool,
    (batch, tape): (&Batch, Tape),
    arrived: Vec<(Wanted, Vec<f32>)>,
    gradients: &mut Gradients,
) {
    let mut pending: Vec<Option<Buffer>> = graph.nodes.iter().map(|_| None).collect();
    for (wanted, gradient) in arrived {
        let mut buffer = pool.take(gradient.len());
        buffer.copy_from_slice(&gradient);
        pending[wanted.node.0] = Some(buffer);
    }
    for node in (0..graph.nodes.len()).rev() {
        let (Some(mut gradient), Some(ran)) = (pending[node].take(), &tape.nodes[node]) else { continue };
        let source = graph.nodes[node].source;
        let layers = &graph.nodes[node].layers.0;
        for (index, layer) in layers.iter().enumerate().rev() {
            let input = match index.checked_sub(1) {
                Some(before) => Input::Numbers(&ran.outputs[before]),
                None => tape.input(graph, batch, node, &ran.rows),
            };
            let mut back =
                (index > 0 || source.is_some()).then(|| pool.take(ran.rows.len() * layer.input_len()));
            let output = &ran.outputs[index];
            layer.backward(params, (input, output), &mut gradient, gradients, back.as_deref_mut());
            pool.give(gradient);
            // Without a source, the first layer's gradient of the input is not wanted, and nothing is left.
            gradient = back.unwrap_or_default();
        }
        if let Some(source) = source {
            pending[source] = Some(sum(pending[source].take(), gradient, &ran.rows, tape.rows, pool));
        }
    }
    pool.recycle(tape);
}

/// Adds the gradient from one more dependent node (for its rows only) to the gradient of a node's output.
fn sum(so_far: Option<Buffer>, add: Buffer, range: &Range<usize>, rows: usize, pool: &Pool) -> Buffer {
    let len = add.len() / range.len().max(1);
    let mut sum = match so_far {
        None if range.len() == rows => return add,
        None => {
            let mut zeros = pool.take(rows * len);
            zeros.fill(0.0);
            zeros
        }
        Some(sum) => sum,
    };
    for (sum, number) in sum[range.start * len..range.end * len].iter_mut().zip(add.iter()) {
        *sum += number;
    }
    pool.give(add);
    sum
}

impl Layer {
    fn forward(&self, params: &Parameters, input: Input<'_>, output: &mut [f32]) {
        match self {
            Self::Conv { weight, bias, conv } => {
                let panels = params.panels(*weight, conv.shape.weights_len(), |weights, panels| {
                    conv.panels(weights, panels);
                });
                let bias = params.slice(*bias);
                match input {
                    Input::Bytes(bytes) => conv::forward_bytes(&conv.shape, bytes, &panels, bias, output),
                    Input::Numbers(numbers) => conv::forward(&conv.shape, numbers, &panels, bias, output),
                }
            }
            Self::Flatten { pixels, channels } => transpose(input.numbers(), (*pixels, *channels), output),
            Self::Linear { weight, bias, shape, activation } => {
                let panels = params.panels(*weight, shape.panels_len(), |weights, panels| {
                    dense::panels(*shape, weights, panels);
                });
                dense::forward(*shape, input.numbers(), &panels, params.slice(*bias), output);
                activation.apply(output);
            }
        }
    }

    /// Computes the gradient of the input, if requested, from that of the output, and writes those of the weights.
    /// Overwrites `gradient`.
    fn backward(
        &self,
        params: &Parameters,
        (input, output): (Input<'_>, &[f32]),
        gradient: &mut [f32],
        gradients: &mut Gradients,
        back: Option<&mut [f32]>,
    ) {
        match self {
            Self::Conv { weight, bias, conv } => {
                activation::relu_gradient(output, gradient);
                activation::sum_rows(gradient, gradients.set(*bias));
                weight_gradient(conv, *weight, input, gradient, gradients);
                if let Some(back) = back {
                    let panels =
                        params.transposed_panels(*weight, conv.shape.weights_len(), |weights, panels| {
                            conv.transposed_panels(weights, panels);
                        });
                    conv::input_gradient(&conv.shape, gradient, &panels, back);
                }
            }
            Self::Flatten { pixels, channels } => {
                if let Some(back) = back {
                    transpose(gradient, (*channels, *pixels), back);
                }
            }
            Self::Linear { weight, bias, shape, activation } => {
                activation.gradient(output, gradient);
                activation::sum_rows(gradient, gradients.set(*bias));
                dense::weight_gradient(*shape, input.numbers(), gradient, gradients.set(*weight));
                if let Some(back) = back {
                    dense::input_gradient(*shape, gradient, params.slice(*weight), back);
                }
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

    /// Converts the gradient of the function's output to that of its input.
    fn gradient(self, output: &[f32], gradient: &mut [f32]) {
        match self {
            Self::Linear => {}
            Self::Relu => activation::relu_gradient(output, gradient),
            Self::Tanh => activation::tanh_gradient(output, gradient),
        }
    }
}

fn weight_gradient(
    conv: &Convolution,
    weight: ParamId,
    input: Input<'_>,
    gradient: &[f32],
    gradients: &mut Gradients,
) {
    let mut panels = vec![0.0; conv.shape.weights_len()];
    match input {
        Input::Bytes(bytes) => conv::add_weight_gradient_bytes(&conv.shape, bytes, gradient, &mut panels),
        Input::Numbers(numbers) => conv::add_weight_gradient(&conv.shape, numbers, gradient, &mut panels),
    }
    conv.read_panels(&panels, gradients.set(weight));
}

/// Transposes each row, a matrix of `rows`×`columns` numbers.
fn transpose(input: &[f32], (rows, columns): (usize, usize), output: &mut [f32]) {
    let len = rows * columns;
    for (input, output) in input.chunks_exact(len).zip(output.chunks_exact_mut(len)) {
        for (at, numbers) in input.chunks_exact(columns).enumerate() {
            for (column, number) in numbers.iter().enumerate() {
                output[column * rows + at] = *number;
            }
        }
    }
}
