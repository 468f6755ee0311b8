//! How fast each layer of the thesis's networks is, forwards and backwards, on every path that this machine can run.
//!
//! `cargo bench -p dril-learn --bench kernels [-- WORD...]` runs the cases whose names hold all words; a number is the
//! batch (64 where there is none), `avx512`, `avx2` and `portable` are the paths. Figures are GFLOP a second of
//! processor time, and their share of what a loop of nothing but fused multiply-adds reaches.
#![allow(clippy::print_stdout, reason = "a program for people")]

mod peak;

use std::hint::black_box;

use dril_learn::kernels::{Buffer, Path, activation, conv, dense, forced, layout, optimizer, paths};

use peak::{peak, per_cpu_second};

/// Spells for each figure, of which the best counts.
const SPELLS: usize = 4;

/// A layer, or one of its gradients, with the multiplications and additions that it takes.
struct Case<'a> {
    name: String,
    flop: usize,
    run: Box<dyn FnMut() + 'a>,
}

fn main() {
    let words: Vec<String> = std::env::args().skip(1).filter(|word| !word.starts_with("--")).collect();
    let batches: Vec<usize> = words.iter().filter_map(|word| word.parse().ok()).collect();
    let batches = if batches.is_empty() { vec![64] } else { batches };
    let name_of = |path: Path| format!("{path:?}").to_lowercase();
    let is_path = |word: &str| ["avx512", "avx2", "portable"].contains(&word);
    let wanted_paths: Vec<&String> = words.iter().filter(|word| is_path(word)).collect();
    let wanted: Vec<&String> =
        words.iter().filter(|word| word.parse::<usize>().is_err() && !is_path(word)).collect();
    for path in paths() {
        // The portable path is for tests and other processors: only where it is asked for, or is the only one.
        let named = wanted_paths.iter().any(|word| **word == name_of(path));
        if !named && (!wanted_paths.is_empty() || (path == Path::Portable && paths().len() > 1)) {
            continue;
        }
        let peak = peak(path, SPELLS);
        println!("{:<44} {peak:>8.1} GFLOP/CPU-second", format!("{} peak", name_of(path)));
        for batch in &batches {
            layers(path, *batch, peak, &wanted);
        }
        if wanted.is_empty() {
            forced(path, elementwise);
        }
    }
}

/// All layers of `dril-cnn`, and of `expert-cnn` what differs.
fn layers(path: Path, batch: usize, peak: f64, wanted: &[&String]) {
    let conv1 = conv::Shape { height: 21, width: 21, channels: 64, filters: 32, kernel: 2, stride: 1 };
    let conv2 = conv::Shape { height: 20, width: 20, channels: 32, filters: 64, kernel: 4, stride: 2 };
    let conv3 = conv::Shape { height: 9, width: 9, channels: 64, filters: 64, kernel: 3, stride: 1 };
    let mut cases = of_bytes("conv1", conv1, batch);
    cases.extend(of_numbers("conv2", conv2, batch));
    cases.extend(of_numbers("conv3", conv3, batch));
    cases.extend(of_numbers("conv3-32", conv::Shape { filters: 32, ..conv3 }, batch));
    for (inputs, outputs) in [(3136, 512), (1568, 512), (512, 512), (512, 2)] {
        cases.extend(of_rows(dense::Shape { inputs, outputs }, batch));
    }
    for Case { name, flop, mut run } in cases {
        if !wanted.iter().all(|word| name.split(' ').any(|part| part == word.as_str())) {
            continue;
        }
        let rate = forced(path, || per_cpu_second(SPELLS, &mut run));
        let reached = rate * flop as f64 * 1e-9;
        let share = reached / peak * 100.0;
        let name = format!("{} {name} batch {batch}", format!("{path:?}").to_lowercase());
        println!("{name:<44} {reached:>8.1} {share:>5.0} % {:>9.3} ms", 1e3 / rate);
    }
}

fn noise(len: usize) -> Buffer {
    let mut state = 1_u32;
    let mut buffer = Buffer::zeros(len);
    for number in buffer.iter_mut() {
        state = state.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
        *number = (state >> 8) as f32 / (1 << 24) as f32 - 0.5;
    }
    buffer
}

fn case<'a>(name: String, flop: usize, run: impl FnMut() + 'a) -> Case<'a> {
    Case { name, flop, run: Box::new(run) }
}

fn of_bytes(name: &str, shape: conv::Shape, batch: usize) -> Vec<Case<'static>> {
    let flop = 2 * batch * shape.positions() * shape.weights_len();
    let bytes: Vec<u8> = (0..batch * shape.input_len()).map(|at| (at * at % 251) as u8).collect();
    let (weights, bias) = (noise(shape.weights_len()), noise(shape.filters));
    let (mut output, gradient) = (noise(batch * shape.output_len()), noise(batch * shape.output_len()));
    let (seen, mut sums) = (bytes.clone(), noise(shape.weights_len()));
    vec![
        case(format!("{name} forward"), flop, move || {
            conv::forward_bytes(&shape, &bytes, &weights, &bias, &mut output);
        }),
        case(format!("{name} weight-gradient"), flop, move || {
            conv::add_weight_gradient_bytes(&shape, &seen, &gradient, &mut sums);
        }),
    ]
}

fn of_numbers(name: &str, shape: conv::Shape, batch: usize) -> Vec<Case<'static>> {
    let flop = 2 * batch * shape.positions() * shape.weights_len();
    let (input, weights, bias) =
        (noise(batch * shape.input_len()), noise(shape.weights_len()), noise(shape.filters));
    let (mut output, gradient) = (noise(batch * shape.output_len()), noise(batch * shape.output_len()));
    let (seen, mut sums, transposed) = (input.clone(), weights.clone(), weights.clone());
    let (mut back, gone) = (input.clone(), gradient.clone());
    vec![
        case(format!("{name} forward"), flop, move || {
            conv::forward(&shape, &input, &weights, &bias, &mut output);
        }),
        case(format!("{name} weight-gradient"), flop, move || {
            conv::add_weight_gradient(&shape, &seen, &gradient, &mut sums);
        }),
        case(format!("{name} input-gradient"), flop, move || {
            conv::input_gradient(&shape, &gone, &transposed, &mut back);
        }),
    ]
}

fn of_rows(shape: dense::Shape, batch: usize) -> Vec<Case<'static>> {
    let dense::Shape { inputs, outputs } = shape;
    let name = format!("dense-{inputs}x{outputs}");
    let flop = 2 * batch * inputs * outputs;
    let (input, weights, bias) = (noise(batch * inputs), noise(inputs * outputs), noise(outputs));
    let (mut output, gradient) = (noise(batch * outputs), noise(batch * outputs));
    let (seen, mut sums, mut back) = (input.clone(), weights.clone(), input.clone());
    let (mut panels, gone) = (Buffer::zeros(shape.panels_len()), gradient.clone());
    dense::panels(shape, &weights, &mut panels);
    vec![
        case(format!("{name} forward"), flop, move || {
            dense::forward(shape, &input, &panels, &bias, &mut output);
        }),
        case(format!("{name} weight-gradient"), flop, move || {
            dense::weight_gradient(shape, &seen, &gradient, &mut sums);
        }),
        case(format!("{name} input-gradient"), flop, move || {
            dense::input_gradient(shape, &gone, &weights, &mut back);
        }),
    ]
}

/// What waits for memory and not for multipliers: milliseconds for the numbers of `dril-cnn` and of its batch of 64.
fn elementwise() {
    let show = |name: &str, call: &mut dyn FnMut()| {
        println!("{name:<44} {:>27.3} ms", 1e3 / per_cpu_second(SPELLS, call));
    };
    let parameters = 2_210_979;
    let (mut value, mut m, gradient) = (noise(parameters), noise(parameters), noise(parameters));
    let mut v = noise(parameters);
    v.iter_mut().for_each(|number| *number *= *number);
    let with = optimizer::Step { scale: 0.7, beta1: 0.9, beta2: 0.999, rate: 1e-9, root: 1.7, epsilon: 1e-5 };
    show("adam step, 2.2 million", &mut || optimizer::step(&mut value, &mut m, &mut v, &gradient, with));
    show("sum of squares, 2.2 million", &mut || {
        black_box(optimizer::sum_of_squares(&gradient));
    });
    let shape = dense::Shape { inputs: 3136, outputs: 512 };
    let (weights, mut panels) = (noise(3136 * 512), Buffer::zeros(shape.panels_len()));
    show("panels, 3136x512", &mut || dense::panels(shape, &weights, &mut panels));
    let (output, mut gradient, mut sums) = (noise(64 * 12_800), noise(64 * 12_800), noise(32));
    show("relu gradient, 64 x 20x20x32", &mut || activation::relu_gradient(&output, &mut gradient));
    show("sum of rows, 64 x 20x20x32", &mut || activation::sum_rows(&output, &mut sums));
    let (bytes, mut numbers) = (vec![7; 28_224], noise(28_224));
    show("bytes to numbers, 84x84x4", &mut || layout::widen(&bytes, &mut numbers));
    let mut numbers = noise(64 * 64);
    show("tanh, 64 x 64", &mut || activation::tanh(&mut numbers));
}
