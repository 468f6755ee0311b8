//! Fully connected layers and their two gradients, with weights as PyTorch keeps them: [outputs, inputs].
//!
//! **Order of sums**, the same on every path; each is one chain of fused multiply-adds:
//! - [`forward`]: begins with the bias and runs through the inputs.
//! - [`weight_gradient`]: from 0 through the rows of the batch.
//! - [`input_gradient`]: from 0 through the outputs.
//!
//! Where a sum is cut so that its operands stay in a near cache, the chain goes on from what was stored.

use super::tile::{Block, Side, add_products, in_blocks};
use super::vector::{Kernel, LANES, Simd, lanes, lanes_mut, load_some, padded, run, store_some};

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

    /// Inputs that fill whole vectors.
    fn whole(self) -> usize {
        self.inputs / LANES * LANES
    }
}

/// Weights as [`forward`] takes them: [outputs / LANES, inputs, LANES], the last panel filled up with zeros.
pub fn panels(shape: Shape, weights: &[f32], panels: &mut [f32]) {
    run(Panels { shape, weights, panels });
}

struct Panels<'a> {
    shape: Shape,
    weights: &'a [f32],
    panels: &'a mut [f32],
}

impl Kernel for Panels<'_> {
    #[inline(always)]
    fn run<S: Simd>(self, simd: S) {
        let Shape { inputs, outputs } = self.shape;
        for (panel, turned) in self.panels.chunks_exact_mut(inputs * LANES).enumerate() {
            let first = panel * LANES;
            let rows = LANES.min(outputs - first);
            for (at, turned) in turned.chunks_mut(LANES * LANES).enumerate() {
                let at = at * LANES;
                let width = LANES.min(inputs - at);
                let mut square = [simd.splat(0.0); LANES];
                for (row, numbers) in square[..rows].iter_mut().enumerate() {
                    *numbers = load_some(simd, &self.weights[(first + row) * inputs + at..][..width]);
                }
                let square = simd.transpose(square);
                for (turned, column) in turned.chunks_exact_mut(LANES).zip(square) {
                    simd.store(column, lanes_mut(turned));
                }
            }
        }
    }
}

/// Inputs that [`forward`] takes at once: those of a minibatch and of two panels stay in the second cache.
const DEPTH: usize = 448;

/// `output = input · weightsᵀ + bias` for any number of rows; the weights are [`panels`].
pub fn forward(shape: Shape, input: &[f32], panels: &[f32], bias: &[f32], output: &mut [f32]) {
    run(Forward { shape, input, panels, bias, output });
}

struct Forward<'a> {
    shape: Shape,
    input: &'a [f32],
    panels: &'a [f32],
    bias: &'a [f32],
    output: &'a mut [f32],
}

impl Kernel for Forward<'_> {
    #[inline(always)]
    fn run<S: Simd>(self, simd: S) {
        let Self { shape, input, panels, bias, output } = self;
        let Shape { inputs, outputs } = shape;
        let (rows, count) = (input.len() / inputs, outputs.div_ceil(LANES));
        for output in output.chunks_exact_mut(outputs) {
            output.copy_from_slice(bias);
        }
        for from in (0..inputs).step_by(DEPTH) {
            let part = (from, DEPTH.min(inputs - from));
            let mut panel = 0;
            while panel < count {
                let output = &mut *output;
                if S::COLUMNS == 2 && panel + 2 <= count {
                    let mut block = ForwardBlock::<2> { shape, part, input, panels, output, panel };
                    in_blocks(simd, rows, &mut block);
                    panel += 2;
                } else {
                    let mut block = ForwardBlock::<1> { shape, part, input, panels, output, panel };
                    in_blocks(simd, rows, &mut block);
                    panel += 1;
                }
            }
        }
    }
}

/// Rows of a batch, for the outputs of `N` panels from `panel` on and some of the inputs.
struct ForwardBlock<'a, const N: usize> {
    shape: Shape,
    part: (usize, usize),
    input: &'a [f32],
    panels: &'a [f32],
    output: &'a mut [f32],
    panel: usize,
}

impl<S: Simd, const N: usize> Block<S> for ForwardBlock<'_, N> {
    #[inline(always)]
    fn rows<const R: usize>(&mut self, simd: S, first: usize) {
        let Shape { inputs, outputs } = self.shape;
        let (from, len) = self.part;
        let input =
            Side { numbers: self.input, starts: starts_of::<R>(first * inputs + from, inputs), outer: 0, inner: 1 };
        let weights = Side {
            numbers: self.panels,
            starts: starts_of::<N>((self.panel * inputs + from) * LANES, inputs * LANES),
            outer: 0,
            inner: LANES,
        };
        let at = self.panel * LANES;
        let used = (outputs - at).min(N * LANES);
        let mut sums = read::<S, R, N>(simd, self.output, (first, outputs), (at, used));
        add_products(simd, &mut sums, (1, len), &input, &weights);
        write(simd, &sums, self.output, (first, outputs), (at, used));
    }
}

/// Reads a block of `R` rows from `first` on, of rows as long as `line`: `used` numbers from `at` on.
#[inline(always)]
fn read<S: Simd, const R: usize, const N: usize>(
    simd: S,
    numbers: &[f32],
    (first, line): (usize, usize),
    (at, used): (usize, usize),
) -> [[S::V; N]; R] {
    let mut sums = [[simd.splat(0.0); N]; R];
    for r in 0..R {
        let row = &numbers[(first + r) * line + at..][..used];
        for j in 0..N {
            sums[r][j] = match used == N * LANES {
                true => simd.load(lanes(&row[j * LANES..])),
                false => load_some(simd, &row[j * LANES..used.min((j + 1) * LANES)]),
            };
        }
    }
    sums
}

/// Writes what [`read`] reads.
#[inline(always)]
fn write<S: Simd, const R: usize, const N: usize>(
    simd: S,
    sums: &[[S::V; N]; R],
    numbers: &mut [f32],
    (first, line): (usize, usize),
    (at, used): (usize, usize),
) {
    for r in 0..R {
        let row = &mut numbers[(first + r) * line + at..][..used];
        for j in 0..N {
            match used == N * LANES {
                true => simd.store(sums[r][j], lanes_mut(&mut row[j * LANES..])),
                false => store_some(simd, sums[r][j], &mut row[j * LANES..used.min((j + 1) * LANES)]),
            }
        }
    }
}

/// `first`, and one further `apart` for each of the others.
#[inline(always)]
fn starts_of<const N: usize>(first: usize, apart: usize) -> [usize; N] {
    let mut starts = [first; N];
    for (at, start) in starts.iter_mut().enumerate() {
        *start += at * apart;
    }
    starts
}

/// Vectors of 16 columns of a matrix whose rows are not whole vectors, filled up with zeros: [rows, LANES].
fn tail(matrix: &[f32], line: usize, whole: usize) -> Vec<f32> {
    match whole == line {
        true => Vec::new(),
        false => matrix.chunks_exact(line).flat_map(|row| padded(&row[whole..])).collect(),
    }
}

/// The gradient of the weights, written over `sums`: gradientᵀ · input.
pub fn weight_gradient(shape: Shape, input: &[f32], gradient: &[f32], sums: &mut [f32]) {
    let Shape { inputs, outputs } = shape;
    let left = Left { numbers: gradient, row: 1, step: outputs };
    let (right, tail) = (input, tail(input, inputs, shape.whole()));
    run(Product { left, right, tail: &tail, line: inputs, depth: input.len() / inputs, cut: WEIGHT_CUT, output: sums });
}

/// The gradient of the input, written over `output`: gradient · weights.
pub fn input_gradient(shape: Shape, gradient: &[f32], weights: &[f32], output: &mut [f32]) {
    let Shape { inputs, outputs } = shape;
    let left = Left { numbers: gradient, row: outputs, step: 1 };
    let (right, tail) = (weights, tail(weights, inputs, shape.whole()));
    run(Product { left, right, tail: &tail, line: inputs, depth: outputs, cut: INPUT_CUT, output });
}

/// Into which pieces a product is cut so that its operands stay in a near cache.
#[derive(Clone, Copy)]
struct Cut {
    /// Steps of a sum.
    depth: usize,
    /// Columns that pass by before the next rows.
    columns: usize,
}

/// The columns of a whole minibatch stay near while all outputs pass by.
const WEIGHT_CUT: Cut = Cut { depth: 256, columns: 512 };
/// A few columns of some weights stay in the nearest cache while the rows of the minibatch pass by.
const INPUT_CUT: Cut = Cut { depth: 64, columns: 2 * LANES };

/// The left matrix: the number of row r in step k is at `r · row + k · step`.
#[derive(Clone, Copy)]
struct Left<'a> {
    numbers: &'a [f32],
    row: usize,
    step: usize,
}

/// `output = left · right`, where `right` is [depth, line] and `output` [rows, line].
struct Product<'a> {
    left: Left<'a>,
    right: &'a [f32],
    /// The last columns of `right`; see [`tail`].
    tail: &'a [f32],
    line: usize,
    depth: usize,
    cut: Cut,
    output: &'a mut [f32],
}

impl Kernel for Product<'_> {
    #[inline(always)]
    fn run<S: Simd>(self, simd: S) {
        let Self { left, right, tail, line, depth, cut, output } = self;
        let (rows, whole) = (output.len() / line, line / LANES * LANES);
        for from in (0..depth).step_by(cut.depth) {
            let part = (from, cut.depth.min(depth - from));
            for column in (0..whole).step_by(cut.columns) {
                let columns = (column, whole.min(column + cut.columns));
                let output = &mut *output;
                let mut block = ProductBlock { left, right: (right, line, 0), line, part, columns, output };
                in_blocks(simd, rows, &mut block);
            }
            if whole < line {
                let output = &mut *output;
                let (right, columns) = ((tail, LANES, whole), (whole, line));
                in_blocks(simd, rows, &mut ProductBlock { left, right, line, part, columns, output });
            }
        }
    }
}

/// Rows of a product, for some columns and steps. `right`: its numbers, the length of its rows, and its first column.
struct ProductBlock<'a> {
    left: Left<'a>,
    right: (&'a [f32], usize, usize),
    line: usize,
    part: (usize, usize),
    columns: (usize, usize),
    output: &'a mut [f32],
}

impl<S: Simd> Block<S> for ProductBlock<'_> {
    #[inline(always)]
    fn rows<const R: usize>(&mut self, simd: S, first: usize) {
        let (mut at, end) = self.columns;
        while at < end {
            if S::COLUMNS == 2 && at + 2 * LANES <= end {
                self.tile::<S, R, 2>(simd, first, (at, 2 * LANES));
                at += 2 * LANES;
            } else {
                self.tile::<S, R, 1>(simd, first, (at, LANES.min(end - at)));
                at += LANES;
            }
        }
    }
}

impl ProductBlock<'_> {
    #[inline(always)]
    fn tile<S: Simd, const R: usize, const N: usize>(
        &mut self,
        simd: S,
        first: usize,
        (at, used): (usize, usize),
    ) {
        let (from, len) = self.part;
        let (numbers, width, column) = self.right;
        let Left { numbers: left, row, step } = self.left;
        let left = Side { numbers: left, starts: starts_of::<R>(first * row + from * step, row), outer: 0, inner: step };
        let right =
            Side { numbers, starts: starts_of::<N>(from * width + at - column, LANES), outer: 0, inner: width };
        let place = ((first, self.line), (at, used));
        let mut sums = [[simd.splat(0.0); N]; R];
        if from > 0 {
            sums = read::<S, R, N>(simd, self.output, place.0, place.1);
        }
        add_products(simd, &mut sums, (1, len), &left, &right);
        write(simd, &sums, self.output, place.0, place.1);
    }
}
