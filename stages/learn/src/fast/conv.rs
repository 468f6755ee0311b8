//! Convolutions over pictures with the channels last, and their two gradients.
//!
//! A window of such a picture is `kernel` runs of `kernel · channels` numbers that lie side by side, so a convolution is
//! a product of matrices whose rows need not be gathered first. Each kernel holds a small block of results in registers
//! while it walks along a sum. Measured beside the convolutions of libtorch on a processor with AVX2: see
//! docs/performance.md.

use std::array::from_fn;

use super::layout;
use super::vector::{LANES, Lanes, add_scaled, in_blocks, lanes, lanes_mut, widest};

/// A convolution without padding.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Shape {
    /// Rows of the input picture.
    pub height: usize,
    /// Columns of the input picture.
    pub width: usize,
    /// Numbers for each of its pixels; `kernel · channels` is a multiple of [`LANES`].
    pub channels: usize,
    /// Numbers for each pixel of the output, a multiple of [`LANES`].
    pub filters: usize,
    /// Rows and columns of the window.
    pub kernel: usize,
    /// Pixels from one window to the next.
    pub stride: usize,
}

impl Shape {
    /// Rows and columns of the output picture.
    pub fn output(&self) -> (usize, usize) {
        let along = |pixels: usize| (pixels - self.kernel) / self.stride + 1;
        (along(self.height), along(self.width))
    }

    /// Pixels of the output picture.
    pub fn positions(&self) -> usize {
        let (height, width) = self.output();
        height * width
    }

    /// Numbers in a window.
    pub fn depth(&self) -> usize {
        self.kernel * self.run()
    }

    /// How many weights there are.
    pub fn weights_len(&self) -> usize {
        self.depth() * self.filters
    }

    /// Numbers of an input picture.
    pub fn input_len(&self) -> usize {
        self.height * self.line()
    }

    /// Numbers of an output picture.
    pub fn output_len(&self) -> usize {
        self.positions() * self.filters
    }

    /// Numbers of a window that lie side by side.
    fn run(&self) -> usize {
        self.kernel * self.channels
    }

    fn line(&self) -> usize {
        self.width * self.channels
    }

    /// Where the window of each output pixel begins in the input picture.
    fn windows(&self) -> Vec<usize> {
        let (height, width) = self.output();
        let at = |row, column| (row * self.width + column) * self.stride * self.channels;
        (0..height).flat_map(|row| (0..width).map(move |column| at(row, column))).collect()
    }
}

/// Output pixels whose windows and gradients stay near while all numbers of the window pass by.
const NEAR: usize = 32;

/// Rows that are computed one block of filters after the other while their windows are near.
const CHUNK: usize = 96;

widest! {
    /// The convolution with bias and ReLU of any number of pictures, one after the other in `input` and `output`.
    /// `weights` are panels: [filters / LANES, depth, LANES].
    pub fn forward(shape: &Shape, input: &[f32], weights: &[f32], bias: &[f32], output: &mut [f32]) = forward_in
}

/// As [`forward`], for pictures of bytes, which are widened one by one: the numbers of a whole minibatch would not stay in
/// a near cache until they are needed.
pub fn forward_bytes(shape: &Shape, input: &[u8], weights: &[f32], bias: &[f32], output: &mut [f32]) {
    let mut numbers = vec![0.0; shape.input_len()];
    let pictures = input.chunks_exact(shape.input_len()).zip(output.chunks_exact_mut(shape.output_len()));
    for (picture, output) in pictures {
        layout::widen(picture, &mut numbers);
        forward(shape, &numbers, weights, bias, output);
    }
}

#[inline(always)]
fn forward_in<const ROWS: usize>(
    shape: &Shape,
    input: &[f32],
    weights: &[f32],
    bias: &[f32],
    output: &mut [f32],
) {
    let (windows, filters) = (shape.windows(), shape.filters);
    for (chunk, output) in output.chunks_mut(CHUNK * filters).enumerate() {
        let first = chunk * CHUNK;
        let rows = output.len() / filters;
        for (panel, weights) in weights.chunks_exact(shape.depth() * LANES).enumerate() {
            let at = panel * LANES;
            let bias = lanes(&bias[at..]);
            let windows = (&windows[..], first);
            let layer = (weights, bias);
            in_blocks!(ROWS, rows, |row| forward_rows(shape, windows, input, layer, (row, at), output));
        }
    }
}

/// Rows `row..row + ROWS` of a chunk whose first output pixel is `first`, for the panel of the filters from `at` on.
#[inline(always)]
fn forward_rows<const ROWS: usize>(
    shape: &Shape,
    (windows, first): (&[usize], usize),
    input: &[f32],
    (weights, bias): (&[f32], &Lanes),
    (row, at): (usize, usize),
    output: &mut [f32],
) {
    let starts = from_fn(|r| {
        let pixel = first + row + r;
        pixel / windows.len() * shape.input_len() + windows[pixel % windows.len()]
    });
    let sums = window_sums::<ROWS>(shape, input, starts, weights, bias);
    for (r, sums) in sums.iter().enumerate() {
        put_rectified(&mut output[(row + r) * shape.filters + at..], sums);
    }
}

#[inline(always)]
fn put_rectified(output: &mut [f32], sums: &Lanes) {
    *lanes_mut(output) = from_fn(|lane| sums[lane].max(0.0));
}

/// Sums over the windows that begin at `starts`, for the filters of one panel.
#[inline(always)]
fn window_sums<const ROWS: usize>(
    shape: &Shape,
    input: &[f32],
    starts: [usize; ROWS],
    weights: &[f32],
    bias: &Lanes,
) -> [Lanes; ROWS] {
    let (run, line) = (shape.run(), shape.line());
    let mut sums = [*bias; ROWS];
    for (ky, weights) in weights.chunks_exact(run * LANES).enumerate() {
        let rows: [&[f32]; ROWS] = from_fn(|r| &input[starts[r] + ky * line..][..run]);
        for k in 0..run {
            let weights = lanes(&weights[k * LANES..][..LANES]);
            for r in 0..ROWS {
                add_scaled(&mut sums[r], rows[r][k], weights);
            }
        }
    }
    sums
}

widest! {
    /// Adds the gradients of the weights to `sums` (panels, as in [`forward`]): `gradient` is that of the sums before
    /// the ReLU, for as many pictures as `input` holds.
    pub fn add_weight_gradient(shape: &Shape, input: &[f32], gradient: &[f32], sums: &mut [f32]) = weight_gradient_in
}

/// As [`add_weight_gradient`], for pictures of bytes; see [`forward_bytes`].
pub fn add_weight_gradient_bytes(shape: &Shape, input: &[u8], gradient: &[f32], sums: &mut [f32]) {
    let mut numbers = vec![0.0; shape.input_len()];
    let pictures = input.chunks_exact(shape.input_len()).zip(gradient.chunks_exact(shape.output_len()));
    for (picture, gradient) in pictures {
        layout::widen(picture, &mut numbers);
        add_weight_gradient(shape, &numbers, gradient, sums);
    }
}

#[inline(always)]
fn weight_gradient_in<const ROWS: usize>(shape: &Shape, input: &[f32], gradient: &[f32], sums: &mut [f32]) {
    let windows = shape.windows();
    let pictures = input.chunks_exact(shape.input_len()).zip(gradient.chunks_exact(shape.output_len()));
    for (input, gradient) in pictures {
        for (windows, gradient) in windows.chunks(NEAR).zip(gradient.chunks(NEAR * shape.filters)) {
            for (panel, sums) in sums.chunks_exact_mut(shape.depth() * LANES).enumerate() {
                let gradient = (&gradient[panel * LANES..], shape.filters);
                add_panel::<ROWS>(shape, windows, input, gradient, sums);
            }
        }
    }
}

/// What some output pixels add to the sums of one panel.
#[inline(always)]
fn add_panel<const ROWS: usize>(
    shape: &Shape,
    windows: &[usize],
    input: &[f32],
    gradient: (&[f32], usize),
    sums: &mut [f32],
) {
    let run = shape.run();
    for (ky, sums) in sums.chunks_exact_mut(run * LANES).enumerate() {
        let input = &input[ky * shape.line()..];
        in_blocks!(ROWS, run, |k| add_products(windows, &input[k..], gradient, &mut sums[k * LANES..]));
    }
}

/// `sums[r] += Σ over windows of input[r] · gradient`, for `ROWS` numbers of the window.
#[inline(always)]
fn add_products<const ROWS: usize>(
    windows: &[usize],
    input: &[f32],
    (gradient, filters): (&[f32], usize),
    sums: &mut [f32],
) {
    let mut products = [[0.0; LANES]; ROWS];
    for (&window, gradient) in windows.iter().zip(gradient.chunks(filters)) {
        let (numbers, gradient) = (&input[window..][..ROWS], lanes(gradient));
        for (products, number) in products.iter_mut().zip(numbers) {
            add_scaled(products, *number, gradient);
        }
    }
    add_rows(sums, &products);
}

#[inline(always)]
fn add_rows<const ROWS: usize>(sums: &mut [f32], rows: &[Lanes; ROWS]) {
    for (sums, row) in sums.chunks_exact_mut(LANES).zip(rows) {
        let sums = lanes_mut(sums);
        *sums = from_fn(|lane| sums[lane] + row[lane]);
    }
}

widest! {
    /// The gradient of the input pictures from that of the sums before the ReLU. `transposed` are panels of the weights
    /// the other way round: [depth / LANES, filters, LANES].
    pub fn input_gradient(shape: &Shape, gradient: &[f32], transposed: &[f32], output: &mut [f32]) = input_gradient_in
}

#[inline(always)]
fn input_gradient_in<const ROWS: usize>(
    shape: &Shape,
    gradient: &[f32],
    transposed: &[f32],
    output: &mut [f32],
) {
    let (windows, filters) = (shape.windows(), shape.filters);
    let panels_in_run = shape.run() / LANES;
    let pictures = gradient.chunks_exact(shape.output_len()).zip(output.chunks_exact_mut(shape.input_len()));
    for (gradient, output) in pictures {
        output.fill(0.0);
        for (panel, weights) in transposed.chunks_exact(filters * LANES).enumerate() {
            let at = panel / panels_in_run * shape.line() + panel % panels_in_run * LANES;
            in_blocks!(ROWS, windows.len(), |first| scatter(
                &gradient[first * filters..],
                weights,
                output,
                (&windows[first..], at),
            ));
        }
    }
}

/// Adds what `ROWS` output pixels give back to the `LANES` numbers from `at` on of their windows. Windows overlap, so they are
/// added one after the other.
#[inline(always)]
fn scatter<const ROWS: usize>(
    gradient: &[f32],
    weights: &[f32],
    output: &mut [f32],
    (windows, at): (&[usize], usize),
) {
    let filters = weights.len() / LANES;
    let rows: [&[f32]; ROWS] = from_fn(|r| &gradient[r * filters..][..filters]);
    let mut sums = [[0.0; LANES]; ROWS];
    for filter in 0..filters {
        let weights = lanes(&weights[filter * LANES..][..LANES]);
        for r in 0..ROWS {
            add_scaled(&mut sums[r], rows[r][filter], weights);
        }
    }
    for (window, sums) in windows.iter().zip(&sums) {
        let output = lanes_mut(&mut output[window + at..]);
        *output = from_fn(|lane| output[lane] + sums[lane]);
    }
}

/// Weights as [`forward`] takes them, [filters / LANES, depth, LANES]. `weight(filter, place)` gives the weight of a
/// number in the window.
pub fn panels(shape: &Shape, weight: impl Fn(usize, usize) -> f32, panels: &mut [f32]) {
    for (panel, numbers) in panels.chunks_exact_mut(shape.depth() * LANES).enumerate() {
        for (place, numbers) in numbers.chunks_exact_mut(LANES).enumerate() {
            for (lane, number) in numbers.iter_mut().enumerate() {
                *number = weight(panel * LANES + lane, place);
            }
        }
    }
}

/// Weights as [`input_gradient`] takes them, [depth / LANES, filters, LANES]; see [`panels`].
pub fn transposed_panels(shape: &Shape, weight: impl Fn(usize, usize) -> f32, panels: &mut [f32]) {
    for (panel, numbers) in panels.chunks_exact_mut(shape.filters * LANES).enumerate() {
        for (filter, numbers) in numbers.chunks_exact_mut(LANES).enumerate() {
            for (lane, number) in numbers.iter_mut().enumerate() {
                *number = weight(filter, panel * LANES + lane);
            }
        }
    }
}

/// Calls `put(filter, place, sum)` for each number of panels that [`add_weight_gradient`] has filled.
pub fn read_panels(shape: &Shape, panels: &[f32], mut put: impl FnMut(usize, usize, f32)) {
    for (panel, sums) in panels.chunks_exact(shape.depth() * LANES).enumerate() {
        for (place, sums) in sums.chunks_exact(LANES).enumerate() {
            for (lane, sum) in sums.iter().enumerate() {
                put(panel * LANES + lane, place, *sum);
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_height_and_width_of_a_block_gives_the_same_bits() {
        let shape = Shape { height: 6, width: 7, channels: 16, filters: 32, kernel: 2, stride: 1 };
        let numbers = |len: usize| -> Vec<f32> { (0..len).map(|at| (at as f32 * 0.37).sin()).collect() };
        let (input, weights) = (numbers(2 * shape.input_len()), numbers(shape.weights_len()));
        let (bias, gradient) = (numbers(shape.filters), numbers(2 * shape.output_len()));
        let (mut widest, mut plain) = (gradient.clone(), gradient.clone());
        forward(&shape, &input, &weights, &bias, &mut widest);
        forward_in::<5>(&shape, &input, &weights, &bias, &mut plain);
        assert_eq!(widest, plain);
        let (mut widest, mut plain) = (weights.clone(), weights.clone());
        add_weight_gradient(&shape, &input, &gradient, &mut widest);
        weight_gradient_in::<5>(&shape, &input, &gradient, &mut plain);
        assert_eq!(widest, plain);
        let (mut widest, mut plain) = (input.clone(), input.clone());
        input_gradient(&shape, &gradient, &weights, &mut widest);
        input_gradient_in::<5>(&shape, &gradient, &weights, &mut plain);
        assert_eq!(widest, plain);
    }
    #[test]
    fn pictures_of_bytes_give_the_bits_of_the_same_numbers() {
        let shape = Shape { height: 6, width: 7, channels: 16, filters: 32, kernel: 2, stride: 1 };
        let bytes: Vec<u8> = (0..3 * shape.input_len()).map(|at| (at * at % 251) as u8).collect();
        let input: Vec<f32> = bytes.iter().map(|byte| f32::from(*byte)).collect();
        let numbers = |len: usize| -> Vec<f32> { (0..len).map(|at| (at as f32 * 0.37).sin()).collect() };
        let (weights, bias) = (numbers(shape.weights_len()), numbers(shape.filters));
        let gradient = numbers(3 * shape.output_len());
        let (mut of_bytes, mut of_numbers) = (gradient.clone(), gradient.clone());
        forward_bytes(&shape, &bytes, &weights, &bias, &mut of_bytes);
        forward(&shape, &input, &weights, &bias, &mut of_numbers);
        assert_eq!(of_bytes, of_numbers);
        let (mut of_bytes, mut of_numbers) = (weights.clone(), weights);
        add_weight_gradient_bytes(&shape, &bytes, &gradient, &mut of_bytes);
        add_weight_gradient(&shape, &input, &gradient, &mut of_numbers);
        assert_eq!(of_bytes, of_numbers);
    }
}
