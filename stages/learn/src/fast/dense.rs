//! Fully connected layers and their two gradients, with weights as PyTorch keeps them: [outputs, inputs].
//!
//! For minibatches as small as these, libtorch spends much of its time on its way to the product; for the small networks
//! of vectors nearly all of it.

use std::array::from_fn;

use super::vector::{LANES, Lanes, add_scaled, in_blocks, lanes, lanes_mut, widest};

/// How many inputs and outputs a layer has.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Shape {
    /// Numbers in.
    pub inputs: usize,
    /// Numbers out.
    pub outputs: usize,
}

impl Shape {
    /// Numbers of [`panels`].
    pub fn panels_len(self) -> usize {
        self.outputs.next_multiple_of(LANES) * self.inputs
    }
}

widest! {
    /// Weights as [`forward`] takes them: [outputs / LANES, inputs, LANES], the last panel filled up with zeros.
    pub fn panels(shape: Shape, weights: &[f32], panels: &mut [f32]) = panels_in
}

/// Squares of `LANES` × `LANES` numbers, which fit the nearest cache, are turned one after the other.
#[inline(always)]
fn panels_in<const ROWS: usize>(Shape { inputs, outputs }: Shape, weights: &[f32], panels: &mut [f32]) {
    let whole = inputs / LANES * LANES;
    for (first, panel) in panels.chunks_exact_mut(inputs * LANES).enumerate() {
        let weights = &weights[first * LANES * inputs..];
        let rows = LANES.min(outputs - first * LANES);
        for at in (0..whole).step_by(LANES) {
            let mut square = [[0.0; LANES]; LANES];
            for (row, numbers) in square[..rows].iter_mut().enumerate() {
                *numbers = *lanes(&weights[row * inputs + at..]);
            }
            for (lane, turned) in panel[at * LANES..].chunks_exact_mut(LANES).take(LANES).enumerate() {
                *lanes_mut(turned) = from_fn(|row| square[row][lane]);
            }
        }
        for (at, turned) in panel.chunks_exact_mut(LANES).enumerate().skip(whole) {
            *lanes_mut(turned) = from_fn(|row| if row < rows { weights[row * inputs + at] } else { 0.0 });
        }
    }
}

widest! {
    /// `output = input · weightsᵀ + bias` for any number of rows; the weights are [`panels`].
    pub fn forward(shape: Shape, input: &[f32], panels: &[f32], bias: &[f32], output: &mut [f32]) = forward_in
}

#[inline(always)]
fn forward_in<const ROWS: usize>(
    shape: Shape,
    input: &[f32],
    panels: &[f32],
    bias: &[f32],
    output: &mut [f32],
) {
    let Shape { inputs, outputs } = shape;
    let rows = input.len() / inputs;
    for (first, panel) in panels.chunks_exact(inputs * LANES).enumerate() {
        let first = first * LANES;
        let bias = &bias[first..outputs.min(first + LANES)];
        let mut start = [0.0; LANES];
        start[..bias.len()].copy_from_slice(bias);
        in_blocks!(ROWS, rows, |row| forward_rows(shape, input, (panel, &start), (row, first), output));
    }
}

/// Rows `row..row + ROWS`, for the panel of the outputs from `first` on.
#[inline(always)]
fn forward_rows<const ROWS: usize>(
    Shape { inputs, outputs }: Shape,
    input: &[f32],
    (panel, start): (&[f32], &Lanes),
    (row, first): (usize, usize),
    output: &mut [f32],
) {
    let used = LANES.min(outputs - first);
    let sums = row_sums::<ROWS>(inputs, &input[row * inputs..], panel, start);
    for (r, sums) in sums.iter().enumerate() {
        output[(row + r) * outputs + first..][..used].copy_from_slice(&sums[..used]);
    }
}

#[inline(always)]
fn row_sums<const ROWS: usize>(inputs: usize, input: &[f32], panel: &[f32], start: &Lanes) -> [Lanes; ROWS] {
    let rows: [&[f32]; ROWS] = from_fn(|r| &input[r * inputs..][..inputs]);
    let mut sums = [*start; ROWS];
    for k in 0..inputs {
        let weights = lanes(&panel[k * LANES..][..LANES]);
        for r in 0..ROWS {
            add_scaled(&mut sums[r], rows[r][k], weights);
        }
    }
    sums
}

widest! {
    /// The gradient of the weights, written over `sums`: gradientᵀ · input.
    pub fn weight_gradient(shape: Shape, input: &[f32], gradient: &[f32], sums: &mut [f32]) = weight_gradient_in
}

#[inline(always)]
fn weight_gradient_in<const ROWS: usize>(shape: Shape, input: &[f32], gradient: &[f32], sums: &mut [f32]) {
    let Shape { inputs, outputs } = shape;
    let whole = inputs / LANES * LANES;
    for at in (0..whole).step_by(LANES) {
        in_blocks!(ROWS, outputs, |output| products(shape, input, gradient, (at, output), sums));
    }
    for output in 0..outputs {
        for at in whole..inputs {
            let rows = input.chunks_exact(inputs).zip(gradient.chunks_exact(outputs));
            sums[output * inputs + at] =
                rows.fold(0.0, |sum, (input, gradient)| gradient[output].mul_add(input[at], sum));
        }
    }
}

/// `LANES` inputs from `at` on, for `ROWS` outputs from `output` on.
#[inline(always)]
fn products<const ROWS: usize>(
    Shape { inputs, outputs }: Shape,
    input: &[f32],
    gradient: &[f32],
    (at, output): (usize, usize),
    sums: &mut [f32],
) {
    let mut products = [[0.0; LANES]; ROWS];
    for (input, gradient) in input.chunks_exact(inputs).zip(gradient.chunks_exact(outputs)) {
        let (input, gradient) = (lanes(&input[at..]), &gradient[output..][..ROWS]);
        for (products, gradient) in products.iter_mut().zip(gradient) {
            add_scaled(products, *gradient, input);
        }
    }
    for (r, products) in products.iter().enumerate() {
        *lanes_mut(&mut sums[(output + r) * inputs + at..]) = *products;
    }
}

widest! {
    /// The gradient of the input, written over `output`: gradient · weights.
    pub fn input_gradient(shape: Shape, gradient: &[f32], weights: &[f32], output: &mut [f32]) = input_gradient_in
}

#[inline(always)]
fn input_gradient_in<const ROWS: usize>(shape: Shape, gradient: &[f32], weights: &[f32], output: &mut [f32]) {
    let Shape { inputs, outputs } = shape;
    let rows = output.len() / inputs;
    let whole = inputs / LANES * LANES;
    for at in (0..whole).step_by(LANES) {
        in_blocks!(ROWS, rows, |row| combine(shape, gradient, weights, (at, row), output));
    }
    for row in 0..rows {
        for at in whole..inputs {
            let columns = gradient[row * outputs..][..outputs].iter().zip(weights.chunks_exact(inputs));
            output[row * inputs + at] =
                columns.fold(0.0, |sum, (gradient, weights)| gradient.mul_add(weights[at], sum));
        }
    }
}

/// `LANES` inputs from `at` on, for `ROWS` rows from `row` on.
#[inline(always)]
fn combine<const ROWS: usize>(
    Shape { inputs, outputs }: Shape,
    gradient: &[f32],
    weights: &[f32],
    (at, row): (usize, usize),
    output: &mut [f32],
) {
    let rows: [&[f32]; ROWS] = from_fn(|r| &gradient[(row + r) * outputs..][..outputs]);
    let mut sums = [[0.0; LANES]; ROWS];
    for (o, weights) in weights.chunks_exact(inputs).take(outputs).enumerate() {
        let weights = lanes(&weights[at..]);
        for r in 0..ROWS {
            add_scaled(&mut sums[r], rows[r][o], weights);
        }
    }
    for (r, sums) in sums.iter().enumerate() {
        *lanes_mut(&mut output[(row + r) * inputs + at..]) = *sums;
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_height_and_width_of_a_block_gives_the_same_bits() {
        let shape = Shape { inputs: 37, outputs: 19 };
        let numbers = |len: usize| -> Vec<f32> { (0..len).map(|at| (at as f32 * 0.37).sin()).collect() };
        let (input, weights) = (numbers(13 * 37), numbers(37 * 19));
        let (bias, gradient) = (numbers(19), numbers(13 * 19));
        let mut turned = vec![0.0; shape.panels_len()];
        panels(shape, &weights, &mut turned);
        let (mut widest, mut plain) = (gradient.clone(), gradient.clone());
        forward(shape, &input, &turned, &bias, &mut widest);
        forward_in::<5>(shape, &input, &turned, &bias, &mut plain);
        assert_eq!(widest, plain);
        let (mut widest, mut plain) = (weights.clone(), weights.clone());
        weight_gradient(shape, &input, &gradient, &mut widest);
        weight_gradient_in::<5>(shape, &input, &gradient, &mut plain);
        assert_eq!(widest, plain);
        let (mut widest, mut plain) = (input.clone(), input.clone());
        input_gradient(shape, &gradient, &weights, &mut widest);
        input_gradient_in::<5>(shape, &gradient, &weights, &mut plain);
        assert_eq!(widest, plain);
    }
}
