//! Fully connected layers and their two gradients, with weights as PyTorch keeps them: [outputs, inputs].
//!
//! **Order of sums**, the same on every path; each is one chain of fused multiply-adds:
//! - [`forward`]: begins with the bias and runs through the inputs.
//! - [`weight_gradient`]: from 0 through the rows of the batch.
//! - [`input_gradient`]: from 0 through the outputs.
//!
//! Where a sum is cut so that its operands stay in a near cache, the chain continues from what was stored.

use super::buffer::with_scratch;
use super::tile::{Block, MOST_ROWS, Side, add_products, in_blocks, starts_of};
use super::vector::{Kernel, LANES, Simd, lanes, lanes_mut, load_some, run, store_some};

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
        let input = Side {
            numbers: self.input,
            starts: starts_of::<R>(first * inputs + from, inputs),
            outer: 0,
            inner: 1,
        };
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

/// The gradient of the weights, written over `sums`: gradientᵀ · input.
pub fn weight_gradient(shape: Shape, input: &[f32], gradient: &[f32], sums: &mut [f32]) {
    let Shape { inputs, outputs } = shape;
    let left = Left { numbers: gradient, row: 1, step: outputs };
    product(left, (input, inputs), input.len() / inputs, WEIGHT_CUT, sums);
}

/// The gradient of the input, written over `output`: gradient · weights.
pub fn input_gradient(shape: Shape, gradient: &[f32], weights: &[f32], output: &mut [f32]) {
    let Shape { inputs, outputs } = shape;
    let left = Left { numbers: gradient, row: outputs, step: 1 };
    product(left, (weights, inputs), outputs, INPUT_CUT, output);
}

/// Into which pieces a product is cut so that its operands stay in a near cache.
#[derive(Clone, Copy)]
struct Cut {
    /// Steps of a sum.
    depth: usize,
    /// Columns that pass by before the next rows, whole vectors.
    columns: usize,
}

/// The columns of a whole minibatch stay near while all outputs pass by; results are written in long runs.
const WEIGHT_CUT: Cut = Cut { depth: 128, columns: 512 };
/// A block of the weights stays in the second cache while the rows of the minibatch pass by.
const INPUT_CUT: Cut = Cut { depth: 128, columns: 512 };

/// The left matrix: the number of row r in step k is at `r · row + k · step`.
#[derive(Clone, Copy)]
struct Left<'a> {
    numbers: &'a [f32],
    row: usize,
    step: usize,
}

/// `output = left · right`, where `right` is [depth, line] and `output` [rows, line].
fn product(left: Left, right: (&[f32], usize), depth: usize, cut: Cut, output: &mut [f32]) {
    if depth == 0 {
        return output.fill(0.0);
    }
    let columns = cut.columns.min(right.1.next_multiple_of(LANES));
    let packed = spaced(cut.depth.min(depth)) * columns;
    with_scratch(packed + cut.depth * MOST_ROWS, |scratch| {
        let (packed, turned) = scratch.split_at_mut(packed);
        run(Product { left, right, depth, cut, packed, turned, output });
    });
}

struct Product<'a> {
    left: Left<'a>,
    /// Its numbers, and how long its rows are.
    right: (&'a [f32], usize),
    depth: usize,
    cut: Cut,
    /// Room for the columns of `right` that pass by.
    packed: &'a mut [f32],
    /// Room for rows of `left` that are columns in memory.
    turned: &'a mut [f32],
    output: &'a mut [f32],
}

impl Kernel for Product<'_> {
    #[inline(always)]
    fn run<S: Simd>(self, simd: S) {
        let Self { left, right, depth, cut, packed, turned, output } = self;
        let line = right.1;
        let rows = output.len() / line;
        for from in (0..depth).step_by(cut.depth) {
            let part = (from, cut.depth.min(depth - from));
            for column in (0..line).step_by(cut.columns) {
                let columns = (column, line.min(column + cut.columns));
                pack(simd, right, part, columns, packed);
                let tiles = rows.div_ceil(S::ROWS) * (columns.1 - columns.0).div_ceil(S::COLUMNS * LANES);
                let ahead = Ahead::after(right, depth, (part, columns), tiles);
                let (packed, turned, output) = (&*packed, &mut *turned, &mut *output);
                let tiles = Tiles { packed, ahead, part, columns, line, output };
                in_blocks(simd, rows, &mut ProductBlock { left, turned, tiles });
            }
        }
    }
}

/// Vectors in the row of a block of results that begins where so many columns are left.
#[inline(always)]
fn vectors<S: Simd>(left: usize) -> usize {
    if S::COLUMNS == 2 && left > LANES { 2 } else { 1 }
}

/// Rows from the start of a packed block to the next: one more than it has, since blocks whose distance is a power of two
/// would all be written to the same place of the nearest cache.
#[inline(always)]
fn spaced(len: usize) -> usize {
    len + 1
}

/// Copies some columns of some rows as blocks of results read them: [columns of a block] rows by row, one block after
/// the other. Rows of the matrix are far apart, often by a multiple of what a cache holds in one place.
#[inline(always)]
fn pack<S: Simd>(
    simd: S,
    (matrix, line): (&[f32], usize),
    (from, len): (usize, usize),
    (first, end): (usize, usize),
    packed: &mut [f32],
) {
    for (k, row) in matrix[from * line..][..len * line].chunks_exact(line).enumerate() {
        let (mut at, row) = (0, &row[first..end]);
        while at < row.len() {
            let width = vectors::<S>(row.len() - at) * LANES;
            let packed = &mut packed[at * spaced(len) + k * width..][..width];
            let row = &row[at..row.len().min(at + width)];
            for (numbers, packed) in row.chunks(LANES).zip(packed.chunks_exact_mut(LANES)) {
                simd.store(load_some(simd, numbers), lanes_mut(packed));
            }
            at += width;
        }
    }
}

/// What will be packed next, asked for while the multipliers are busy: it comes from a far cache or from memory, in
/// runs too short for the processor to see what comes next.
struct Ahead<'a> {
    numbers: &'a [f32],
    line: usize,
    /// The next row and column.
    next: (usize, usize),
    rows_end: usize,
    columns: (usize, usize),
    /// Cache lines to ask for with each tile.
    each: usize,
}

impl<'a> Ahead<'a> {
    /// Of the block after the one of `len` rows from `from` on and the columns `first..end`, while `tiles` are computed.
    #[inline(always)]
    fn after(
        (numbers, line): (&'a [f32], usize),
        depth: usize,
        ((from, len), (first, end)): ((usize, usize), (usize, usize)),
        tiles: usize,
    ) -> Self {
        let (rows, columns) = match end < line {
            true => ((from, from + len), (end, line.min(2 * end - first))),
            false => ((from + len, depth.min(from + 2 * len)), (0, end - first)),
        };
        let lines = (rows.1 - rows.0) * (columns.1 - columns.0) / LANES;
        Self {
            numbers,
            line,
            next: (rows.0, columns.0),
            rows_end: rows.1,
            columns,
            each: lines.div_ceil(tiles.max(1)),
        }
    }

    /// Asks for the next lines.
    #[inline(always)]
    fn advance<S: Simd>(&mut self, simd: S) {
        let (mut row, mut column) = self.next;
        for _ in 0..self.each {
            if row >= self.rows_end {
                break;
            }
            simd.prefetch(self.numbers, row * self.line + column);
            column += LANES;
            if column >= self.columns.1 {
                (row, column) = (row + 1, self.columns.0);
            }
        }
        self.next = (row, column);
    }
}

/// Rows of a product, for some columns and steps.
struct ProductBlock<'a> {
    left: Left<'a>,
    turned: &'a mut [f32],
    tiles: Tiles<'a>,
}

impl<S: Simd> Block<S> for ProductBlock<'_> {
    #[inline(always)]
    fn rows<const R: usize>(&mut self, simd: S, first: usize) {
        let Left { numbers, row, step } = self.left;
        let (from, len) = self.tiles.part;
        let start = first * row + from * step;
        if row != 1 || step == 1 {
            let left = Side { numbers, starts: starts_of::<R>(start, row), outer: 0, inner: step };
            self.tiles.compute(simd, first, &left);
            return;
        }
        for (k, turned) in self.turned[..len * R].chunks_exact_mut(R).enumerate() {
            turned.copy_from_slice(&numbers[start + k * step..][..R]);
        }
        let left = Side { numbers: &*self.turned, starts: starts_of::<R>(0, 1), outer: 0, inner: R };
        self.tiles.compute(simd, first, &left);
    }
}

/// What the rows of a product have in common.
struct Tiles<'a> {
    /// See [`pack`].
    packed: &'a [f32],
    ahead: Ahead<'a>,
    /// The first step, and how many.
    part: (usize, usize),
    /// The first column, and the end.
    columns: (usize, usize),
    /// How long the rows of `output` are.
    line: usize,
    output: &'a mut [f32],
}

impl Tiles<'_> {
    /// `R` rows from `first` on, one tile after the other.
    #[inline(always)]
    fn compute<S: Simd, const R: usize>(&mut self, simd: S, first: usize, left: &Side<R>) {
        let (mut at, end) = self.columns;
        while at < end {
            self.ahead.advance(simd);
            let count = vectors::<S>(end - at);
            match count {
                2 => self.tile::<S, R, 2>(simd, (first, at), left),
                _ => self.tile::<S, R, 1>(simd, (first, at), left),
            }
            at += count * LANES;
        }
    }

    #[inline(always)]
    fn tile<S: Simd, const R: usize, const N: usize>(
        &mut self,
        simd: S,
        (first, at): (usize, usize),
        left: &Side<R>,
    ) {
        let ((from, len), (column, end)) = (self.part, self.columns);
        let (rows, columns) = ((first, self.line), (at, (end - at).min(N * LANES)));
        let right = Side {
            numbers: self.packed,
            starts: starts_of::<N>((at - column) * spaced(len), LANES),
            outer: 0,
            inner: N * LANES,
        };
        let mut sums = [[simd.splat(0.0); N]; R];
        if from > 0 {
            sums = read::<S, R, N>(simd, self.output, rows, columns);
        }
        add_products(simd, &mut sums, (1, len), left, &right);
        write(simd, &sums, self.output, rows, columns);
    }
}
