//! Convolutions without padding over images with the channels last, and their two gradients.
//!
//! A window of such an image is `kernel` runs of `kernel · channels` numbers that lie side by side, so a convolution is
//! a product of matrices whose rows need not be gathered first (an implicit im2col).
//!
//! **Order of sums**, the same on every path:
//! - [`forward`]: one chain of fused multiply-adds that begins with the bias and runs through the window row by row,
//!   pixel by pixel, channel by channel.
//! - [`add_weight_gradient`]: for each image, its output lines in groups of [`lines_in_group`]; one chain through a
//!   group, from 0, then added to the sum.
//! - [`input_gradient`]: for each output pixel and place of the window one chain through the filters, from 0; an input
//!   pixel adds up its chains in the order of the places in the window.

use super::buffer::with_scratch;
use super::layout;
use super::tile::{Block, Side, add_products, in_blocks, starts_of};
use super::vector::{Kernel, LANES, Simd, lanes, lanes_mut, run};

/// A convolution without padding.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Shape {
    /// Rows of the input image.
    pub height: usize,
    /// Columns of the input image.
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
    /// Rows and columns of the output image.
    pub fn output(&self) -> (usize, usize) {
        let along = |pixels: usize| (pixels - self.kernel) / self.stride + 1;
        (along(self.height), along(self.width))
    }

    /// Pixels of the output image.
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

    /// Numbers of an input image.
    pub fn input_len(&self) -> usize {
        self.height * self.line()
    }

    /// Numbers of an output image.
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

    /// Where the window of each output pixel begins in the input image.
    fn windows(&self) -> Vec<usize> {
        let (height, width) = self.output();
        let at = |row, column| (row * self.width + column) * self.stride * self.channels;
        (0..height).flat_map(|row| (0..width).map(move |column| at(row, column))).collect()
    }
}

/// The convolution with bias and ReLU of any number of images, one after the other in `input` and `output`. `weights`
/// are panels: [filters / LANES, depth, LANES]; see [`panels`].
pub fn forward(shape: &Shape, input: &[f32], weights: &[f32], bias: &[f32], output: &mut [f32]) {
    run(Forward { shape, windows: &shape.windows(), input, weights, bias, output });
}

/// As [`forward`], for images of bytes, which are widened one by one: the numbers of a whole minibatch would not stay in
/// a near cache until they are needed.
pub fn forward_bytes(shape: &Shape, input: &[u8], weights: &[f32], bias: &[f32], output: &mut [f32]) {
    let windows = shape.windows();
    let images = input.chunks_exact(shape.input_len()).zip(output.chunks_exact_mut(shape.output_len()));
    with_scratch(shape.input_len(), |numbers| {
        for (image, output) in images {
            layout::widen(image, numbers);
            run(Forward { shape, windows: &windows, input: numbers, weights, bias, output });
        }
    });
}

struct Forward<'a> {
    shape: &'a Shape,
    windows: &'a [usize],
    input: &'a [f32],
    weights: &'a [f32],
    bias: &'a [f32],
    output: &'a mut [f32],
}

impl Kernel for Forward<'_> {
    #[inline(always)]
    fn run<S: Simd>(self, simd: S) {
        let Self { shape, windows, input, weights, bias, output } = self;
        let images = input.chunks_exact(shape.input_len()).zip(output.chunks_exact_mut(shape.output_len()));
        let panels = shape.filters / LANES;
        for (input, output) in images {
            let mut panel = 0;
            while panel < panels {
                let output = &mut *output;
                if S::COLUMNS == 2 && panel + 2 <= panels {
                    let mut block = ForwardBlock::<2> { shape, windows, input, weights, bias, output, panel };
                    in_blocks(simd, windows.len(), &mut block);
                    panel += 2;
                } else {
                    let mut block = ForwardBlock::<1> { shape, windows, input, weights, bias, output, panel };
                    in_blocks(simd, windows.len(), &mut block);
                    panel += 1;
                }
            }
        }
    }
}

/// Output pixels of an image, for the filters of `N` panels from `panel` on.
struct ForwardBlock<'a, const N: usize> {
    shape: &'a Shape,
    windows: &'a [usize],
    input: &'a [f32],
    weights: &'a [f32],
    bias: &'a [f32],
    output: &'a mut [f32],
    panel: usize,
}

impl<S: Simd, const N: usize> Block<S> for ForwardBlock<'_, N> {
    #[inline(always)]
    fn rows<const R: usize>(&mut self, simd: S, first: usize) {
        let (shape, at) = (self.shape, self.panel * LANES);
        let mut starts = [0; R];
        starts.copy_from_slice(&self.windows[first..first + R]);
        let input = Side { numbers: self.input, starts, outer: shape.line(), inner: 1 };
        let weights = Side {
            numbers: self.weights,
            starts: starts_of(self.panel * LANES * shape.depth(), LANES * shape.depth()),
            outer: LANES * shape.run(),
            inner: LANES,
        };
        let mut row = [simd.splat(0.0); N];
        for j in 0..N {
            row[j] = simd.load(lanes(&self.bias[at + j * LANES..]));
        }
        let mut sums = [row; R];
        add_products(simd, &mut sums, (shape.kernel, shape.run()), &input, &weights);
        for (r, sums) in sums.iter().enumerate() {
            let output = &mut self.output[(first + r) * shape.filters + at..][..N * LANES];
            for j in 0..N {
                simd.store(simd.relu(sums[j]), lanes_mut(&mut output[j * LANES..]));
            }
        }
    }
}

/// Output lines whose part of the weights' gradient is one chain: about 100 pixels, which stay in the nearest cache with
/// their windows.
fn lines_in_group(shape: &Shape) -> usize {
    let (height, width) = shape.output();
    (100 / width).clamp(1, height)
}

/// Adds the gradients of the weights to `sums` (panels, as in [`forward`]): `gradient` is that of the sums before the
/// ReLU, for as many images as `input` holds.
pub fn add_weight_gradient(shape: &Shape, input: &[f32], gradient: &[f32], sums: &mut [f32]) {
    run(WeightGradient { shape, input, gradient, sums });
}

/// As [`add_weight_gradient`], for images of bytes; see [`forward_bytes`].
pub fn add_weight_gradient_bytes(shape: &Shape, input: &[u8], gradient: &[f32], sums: &mut [f32]) {
    let images = input.chunks_exact(shape.input_len()).zip(gradient.chunks_exact(shape.output_len()));
    with_scratch(shape.input_len(), |numbers| {
        for (image, gradient) in images {
            layout::widen(image, numbers);
            run(WeightGradient { shape, input: numbers, gradient, sums });
        }
    });
}

struct WeightGradient<'a> {
    shape: &'a Shape,
    input: &'a [f32],
    gradient: &'a [f32],
    sums: &'a mut [f32],
}

impl Kernel for WeightGradient<'_> {
    #[inline(always)]
    fn run<S: Simd>(self, simd: S) {
        let Self { shape, input, gradient, sums } = self;
        let ((height, width), group) = (shape.output(), lines_in_group(shape));
        let images = input.chunks_exact(shape.input_len()).zip(gradient.chunks_exact(shape.output_len()));
        for (input, gradient) in images {
            for top in (0..height).step_by(group) {
                let input = &input[top * shape.stride * shape.line()..];
                let gradient = &gradient[top * width * shape.filters..];
                let steps = (group.min(height - top), width);
                weight_gradient_of_lines(simd, (shape, steps), input, gradient, sums);
            }
        }
    }
}

#[inline(always)]
fn weight_gradient_of_lines<S: Simd>(
    simd: S,
    (shape, steps): (&Shape, (usize, usize)),
    input: &[f32],
    gradient: &[f32],
    sums: &mut [f32],
) {
    let panels = shape.filters / LANES;
    let mut panel = 0;
    while panel < panels {
        for ky in 0..shape.kernel {
            if S::COLUMNS == 2 && panel + 2 <= panels {
                let mut block = WeightBlock::<2> { shape, steps, input, gradient, sums, panel, ky };
                in_blocks(simd, shape.run(), &mut block);
            } else {
                let mut block = WeightBlock::<1> { shape, steps, input, gradient, sums, panel, ky };
                in_blocks(simd, shape.run(), &mut block);
            }
        }
        panel += if S::COLUMNS == 2 && panel + 2 <= panels { 2 } else { 1 };
    }
}

/// Numbers of line `ky` of the window, for the filters of `N` panels from `panel` on, over some output lines.
struct WeightBlock<'a, const N: usize> {
    shape: &'a Shape,
    steps: (usize, usize),
    input: &'a [f32],
    gradient: &'a [f32],
    sums: &'a mut [f32],
    panel: usize,
    ky: usize,
}

impl<S: Simd, const N: usize> Block<S> for WeightBlock<'_, N> {
    #[inline(always)]
    fn rows<const R: usize>(&mut self, simd: S, first: usize) {
        let shape = self.shape;
        let input = Side {
            numbers: self.input,
            starts: starts_of::<R>(self.ky * shape.line() + first, 1),
            outer: shape.stride * shape.line(),
            inner: shape.stride * shape.channels,
        };
        let gradient = Side {
            numbers: self.gradient,
            starts: starts_of::<N>(self.panel * LANES, LANES),
            outer: self.steps.1 * shape.filters,
            inner: shape.filters,
        };
        let mut products = [[simd.splat(0.0); N]; R];
        add_products(simd, &mut products, self.steps, &input, &gradient);
        for j in 0..N {
            let at = ((self.panel + j) * shape.depth() + self.ky * shape.run() + first) * LANES;
            let sums = &mut self.sums[at..][..R * LANES];
            for r in 0..R {
                let sums = lanes_mut(&mut sums[r * LANES..]);
                simd.store(simd.add(simd.load(sums), products[r][j]), sums);
            }
        }
    }
}

/// The gradient of the input images, written over `output`, from that of the sums before the ReLU. `transposed` are
/// panels of the weights the other way round: [depth / LANES, filters, LANES]; see [`transposed_panels`].
pub fn input_gradient(shape: &Shape, gradient: &[f32], transposed: &[f32], output: &mut [f32]) {
    run(InputGradient { shape, windows: &shape.windows(), gradient, transposed, output });
}

struct InputGradient<'a> {
    shape: &'a Shape,
    windows: &'a [usize],
    gradient: &'a [f32],
    transposed: &'a [f32],
    output: &'a mut [f32],
}

impl Kernel for InputGradient<'_> {
    #[inline(always)]
    fn run<S: Simd>(self, simd: S) {
        let Self { shape, windows, gradient, transposed, output } = self;
        let images =
            gradient.chunks_exact(shape.output_len()).zip(output.chunks_exact_mut(shape.input_len()));
        // Two panels at once only where they lie in one pixel: so no two pixels of a block add to the same number, and
        // numbers add up in the same order as with one panel at once.
        let step = if S::COLUMNS == 2 && shape.channels.is_multiple_of(2 * LANES) { 2 } else { 1 };
        for (gradient, output) in images {
            output.fill(0.0);
            for panel in (0..shape.depth() / LANES).step_by(step) {
                let output = &mut *output;
                if step == 2 {
                    let mut block = InputBlock::<2> { shape, windows, gradient, transposed, output, panel };
                    in_blocks(simd, windows.len(), &mut block);
                } else {
                    let mut block = InputBlock::<1> { shape, windows, gradient, transposed, output, panel };
                    in_blocks(simd, windows.len(), &mut block);
                }
            }
        }
    }
}

/// What output pixels of an image give back to `N` panels of their windows, from `panel` on.
struct InputBlock<'a, const N: usize> {
    shape: &'a Shape,
    windows: &'a [usize],
    gradient: &'a [f32],
    transposed: &'a [f32],
    output: &'a mut [f32],
    panel: usize,
}

impl<S: Simd, const N: usize> Block<S> for InputBlock<'_, N> {
    #[inline(always)]
    fn rows<const R: usize>(&mut self, simd: S, first: usize) {
        let filters = self.shape.filters;
        let gradient = Side {
            numbers: self.gradient,
            starts: starts_of::<R>(first * filters, filters),
            outer: 0,
            inner: 1,
        };
        let weights = Side {
            numbers: self.transposed,
            starts: starts_of::<N>(self.panel * filters * LANES, filters * LANES),
            outer: 0,
            inner: LANES,
        };
        let mut sums = [[simd.splat(0.0); N]; R];
        add_products(simd, &mut sums, (1, filters), &gradient, &weights);
        let panels_in_run = self.shape.run() / LANES;
        let at = self.panel / panels_in_run * self.shape.line() + self.panel % panels_in_run * LANES;
        for (window, sums) in self.windows[first..first + R].iter().zip(sums) {
            let output = &mut self.output[window + at..][..N * LANES];
            for j in 0..N {
                let output = lanes_mut(&mut output[j * LANES..]);
                simd.store(simd.add(simd.load(output), sums[j]), output);
            }
        }
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
