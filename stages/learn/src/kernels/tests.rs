//! Every path gives the same bits, and they are those of the sums that the modules document.

use super::{activation, conv, dense, forced, layout, optimizer, path, paths};

/// Numbers without a pattern that a wrong index could meet by chance.
fn numbers(len: usize, seed: u32) -> Vec<f32> {
    let mut state = seed.wrapping_mul(2_654_435_761).wrapping_add(12_345);
    let mut next = || {
        state ^= state << 13;
        state ^= state >> 17;
        state ^= state << 5;
        (state >> 8) as f32 / (1 << 23) as f32 - 1.0
    };
    (0..len).map(|_| next()).collect()
}

/// What `compute` gives on every path of the machine, which must be one thing.
fn on_all_paths(what: &str, compute: impl Fn() -> Vec<f32>) -> Vec<f32> {
    let bits = |numbers: &[f32]| numbers.iter().map(|number| number.to_bits()).collect::<Vec<_>>();
    let mut results = paths().into_iter().map(|wanted| {
        forced(wanted, || {
            assert_eq!(path(), wanted);
            (wanted, compute())
        })
    });
    let (first, result) = results.next().unwrap();
    for (path, other) in results {
        assert!(bits(&result) == bits(&other), "{what}: {first:?} and {path:?} differ");
    }
    result
}

fn equal(what: &str, found: &[f32], wanted: &[f32]) {
    assert_eq!(found.len(), wanted.len(), "{what}");
    let first = found.iter().zip(wanted).position(|(a, b)| a.to_bits() != b.to_bits());
    assert!(first.is_none(), "{what}: number {first:?} is not that of the documented sum");
}

const DENSE: [(usize, usize, usize); 9] = [
    (1, 1, 1),
    (3, 8, 2),
    (8, 37, 19),
    (13, 64, 64),
    (7, 100, 33),
    (29, 48, 70),
    (300, 17, 5),
    (5, 1000, 40),
    (64, 513, 129),
];

#[test]
fn dense_layers_are_one_chain_of_fused_products() {
    for (rows, inputs, outputs) in DENSE {
        let shape = dense::Shape { inputs, outputs };
        let (input, weights) = (numbers(rows * inputs, 1), numbers(inputs * outputs, 2));
        let (bias, gradient) = (numbers(outputs, 3), numbers(rows * outputs, 4));
        let what = format!("{rows} rows, {shape:?}");
        let found = on_all_paths(&what, || {
            let mut panels = vec![7.0; shape.panels_len()];
            dense::panels(shape, &weights, &mut panels);
            let mut output = vec![7.0; rows * outputs];
            dense::forward(shape, &input, &panels, &bias, &mut output);
            output
        });
        let wanted: Vec<f32> = (0..rows * outputs)
            .map(|at| {
                let (row, output) = (&input[at / outputs * inputs..], at % outputs);
                let weights = &weights[output * inputs..][..inputs];
                row.iter().zip(weights).fold(bias[output], |sum, (x, w)| x.mul_add(*w, sum))
            })
            .collect();
        equal(&what, &found, &wanted);
        let found = on_all_paths(&what, || {
            let mut sums = vec![7.0; inputs * outputs];
            dense::weight_gradient(shape, &input, &gradient, &mut sums);
            sums
        });
        let wanted: Vec<f32> = (0..inputs * outputs)
            .map(|at| {
                let (output, input_at) = (at / inputs, at % inputs);
                (0..rows).fold(0.0, |sum, row| {
                    gradient[row * outputs + output].mul_add(input[row * inputs + input_at], sum)
                })
            })
            .collect();
        equal(&what, &found, &wanted);
        let found = on_all_paths(&what, || {
            let mut back = vec![7.0; rows * inputs];
            dense::input_gradient(shape, &gradient, &weights, &mut back);
            back
        });
        let wanted: Vec<f32> = (0..rows * inputs)
            .map(|at| {
                let (row, input_at) = (at / inputs, at % inputs);
                (0..outputs).fold(0.0, |sum, output| {
                    gradient[row * outputs + output].mul_add(weights[output * inputs + input_at], sum)
                })
            })
            .collect();
        equal(&what, &found, &wanted);
    }
}

const CONVOLUTIONS: [conv::Shape; 6] = [
    conv::Shape { height: 6, width: 7, channels: 16, filters: 48, kernel: 2, stride: 1 },
    conv::Shape { height: 9, width: 8, channels: 64, filters: 32, kernel: 2, stride: 1 },
    conv::Shape { height: 9, width: 11, channels: 32, filters: 64, kernel: 4, stride: 2 },
    conv::Shape { height: 5, width: 5, channels: 48, filters: 16, kernel: 3, stride: 1 },
    conv::Shape { height: 30, width: 41, channels: 16, filters: 16, kernel: 1, stride: 1 },
    conv::Shape { height: 3, width: 3, channels: 32, filters: 32, kernel: 3, stride: 1 },
];

/// Where number `place` of the window of output pixel `position` stands in an image.
fn window(shape: &conv::Shape, position: usize, place: usize) -> usize {
    let (_, width) = shape.output();
    let (y, x) = (position / width * shape.stride, position % width * shape.stride);
    let run = shape.kernel * shape.channels;
    ((y + place / run) * shape.width + x) * shape.channels + place % run
}

#[test]
fn convolutions_are_sums_in_the_documented_order() {
    for shape in &CONVOLUTIONS {
        let images = 3;
        let (depth, filters, positions) = (shape.depth(), shape.filters, shape.positions());
        let input = numbers(images * shape.input_len(), 1);
        let weights = numbers(shape.weights_len(), 2);
        let (bias, gradient) = (numbers(filters, 3), numbers(images * shape.output_len(), 4));
        let mut panels = vec![0.0; shape.weights_len()];
        conv::panels(shape, |filter, place| weights[filter * depth + place], &mut panels);
        let what = format!("{shape:?}");
        let found = on_all_paths(&what, || {
            let mut output = vec![7.0; images * shape.output_len()];
            conv::forward(shape, &input, &panels, &bias, &mut output);
            output
        });
        let wanted: Vec<f32> = (0..images * positions * filters)
            .map(|at| {
                let (image, position, filter) =
                    (at / filters / positions, at / filters % positions, at % filters);
                let image = &input[image * shape.input_len()..];
                let sum = (0..depth).fold(bias[filter], |sum, place| {
                    image[window(shape, position, place)].mul_add(weights[filter * depth + place], sum)
                });
                if sum < 0.0 { 0.0 } else { sum }
            })
            .collect();
        equal(&what, &found, &wanted);
        weight_gradients(shape, &input, &gradient);
        input_gradients(shape, &weights, &gradient);
    }
}

fn weight_gradients(shape: &conv::Shape, input: &[f32], gradient: &[f32]) {
    let (depth, filters) = (shape.depth(), shape.filters);
    let before = numbers(shape.weights_len(), 5);
    let what = format!("gradient of the weights, {shape:?}");
    let found = on_all_paths(&what, || {
        let mut sums = vec![0.0; shape.weights_len()];
        conv::panels(shape, |filter, place| before[filter * depth + place], &mut sums);
        conv::add_weight_gradient(shape, input, gradient, &mut sums);
        let mut plain = vec![0.0; shape.weights_len()];
        conv::read_panels(shape, &sums, |filter, place, sum| plain[filter * depth + place] = sum);
        plain
    });
    let (height, width) = shape.output();
    let lines = (100 / width).clamp(1, height);
    let images = input.chunks(shape.input_len()).zip(gradient.chunks(shape.output_len()));
    let mut wanted = before.clone();
    for (input, gradient) in images {
        for top in (0..height).step_by(lines) {
            let positions = top * width..(top + lines).min(height) * width;
            for (at, sum) in wanted.iter_mut().enumerate() {
                let (filter, place) = (at / depth, at % depth);
                *sum += positions.clone().fold(0.0, |sum, position| {
                    input[window(shape, position, place)].mul_add(gradient[position * filters + filter], sum)
                });
            }
        }
    }
    equal(&what, &found, &wanted);
}

fn input_gradients(shape: &conv::Shape, weights: &[f32], gradient: &[f32]) {
    let (depth, filters) = (shape.depth(), shape.filters);
    let mut panels = vec![0.0; shape.weights_len()];
    conv::transposed_panels(shape, |filter, place| weights[filter * depth + place], &mut panels);
    let images = gradient.len() / shape.output_len();
    let what = format!("gradient of the input, {shape:?}");
    let found = on_all_paths(&what, || {
        let mut back = vec![7.0; images * shape.input_len()];
        conv::input_gradient(shape, gradient, &panels, &mut back);
        back
    });
    let mut wanted = vec![0.0; images * shape.input_len()];
    for (gradient, wanted) in gradient.chunks(shape.output_len()).zip(wanted.chunks_mut(shape.input_len())) {
        for place in 0..depth {
            for (position, gradient) in gradient.chunks(filters).enumerate() {
                let sum = gradient
                    .iter()
                    .enumerate()
                    .fold(0.0, |sum, (filter, g)| g.mul_add(weights[filter * depth + place], sum));
                wanted[window(shape, position, place)] += sum;
            }
        }
    }
    equal(&what, &found, &wanted);
}

#[test]
fn images_of_bytes_give_the_bits_of_the_same_numbers() {
    let shape = conv::Shape { height: 6, width: 7, channels: 16, filters: 32, kernel: 2, stride: 1 };
    let bytes: Vec<u8> = (0..3 * shape.input_len()).map(|at| (at * at % 251) as u8).collect();
    let input: Vec<f32> = bytes.iter().map(|byte| f32::from(*byte)).collect();
    let (weights, bias) = (numbers(shape.weights_len(), 1), numbers(shape.filters, 2));
    let gradient = numbers(3 * shape.output_len(), 3);
    let (mut of_bytes, mut of_numbers) = (gradient.clone(), gradient.clone());
    conv::forward_bytes(&shape, &bytes, &weights, &bias, &mut of_bytes);
    conv::forward(&shape, &input, &weights, &bias, &mut of_numbers);
    assert_eq!(of_bytes, of_numbers);
    let (mut of_bytes, mut of_numbers) = (weights.clone(), weights);
    conv::add_weight_gradient_bytes(&shape, &bytes, &gradient, &mut of_bytes);
    conv::add_weight_gradient(&shape, &input, &gradient, &mut of_numbers);
    assert_eq!(of_bytes, of_numbers);
}

#[test]
fn the_result_of_a_row_does_not_depend_on_the_other_rows() {
    let shape = dense::Shape { inputs: 531, outputs: 37 };
    let (input, weights) = (numbers(40 * 531, 1), numbers(531 * 37, 2));
    let (bias, gradient) = (numbers(37, 3), numbers(40 * 37, 4));
    let mut panels = vec![0.0; shape.panels_len()];
    dense::panels(shape, &weights, &mut panels);
    let forward = |rows: std::ops::Range<usize>| {
        let mut output = vec![0.0; rows.len() * 37];
        dense::forward(shape, &input[rows.start * 531..rows.end * 531], &panels, &bias, &mut output);
        output
    };
    let back = |rows: std::ops::Range<usize>| {
        let mut output = vec![0.0; rows.len() * 531];
        dense::input_gradient(shape, &gradient[rows.start * 37..rows.end * 37], &weights, &mut output);
        output
    };
    let (all, all_back) = (forward(0..40), back(0..40));
    for rows in [0..1, 3..11, 17..40] {
        assert_eq!(all[rows.start * 37..rows.end * 37], forward(rows.clone()));
        assert_eq!(all_back[rows.start * 531..rows.end * 531], back(rows));
    }
}

#[test]
fn an_empty_batch_gives_no_rows_and_no_gradient() {
    let shape = dense::Shape { inputs: 40, outputs: 3 };
    let mut sums = numbers(120, 1);
    dense::weight_gradient(shape, &[], &[], &mut sums);
    assert!(sums.iter().all(|sum| *sum == 0.0));
    dense::forward(shape, &[], &numbers(40 * 16, 1), &numbers(3, 2), &mut []);
    dense::input_gradient(shape, &[], &numbers(120, 1), &mut []);
}

#[test]
fn elementwise_functions_give_the_same_bits_on_every_path() {
    for len in [0, 1, 15, 16, 17, 1003, 4096, 9001] {
        let odd: Vec<f32> = numbers(len, 1).iter().map(|x| x * 12.0).collect();
        let special = [f32::NAN, f32::INFINITY, -f32::INFINITY, 0.0, -0.0, 1e-40, -1e-40];
        let odd = [odd, special.to_vec()].concat();
        let other = numbers(odd.len(), 2);
        let with =
            optimizer::Step { scale: 0.7, beta1: 0.9, beta2: 0.999, rate: 3e-3, root: 1.7, epsilon: 1e-5 };
        on_all_paths("elementwise", || {
            let (mut relu, mut tanh) = (odd.clone(), odd.clone());
            activation::relu(&mut relu);
            activation::tanh(&mut tanh);
            let (mut of_relu, mut of_tanh) = (other.clone(), other.clone());
            activation::relu_gradient(&relu, &mut of_relu);
            activation::tanh_gradient(&tanh, &mut of_tanh);
            let (mut value, mut m) = (other.clone(), other.clone());
            let mut v: Vec<f32> = other.iter().map(|x| x * x).collect();
            optimizer::step(&mut value, &mut m, &mut v, &odd, with);
            let mut widened = vec![0.0; len];
            let bytes: Vec<u8> = (0..len).map(|at| (at * at % 256) as u8).collect();
            layout::widen(&bytes, &mut widened);
            let squares = optimizer::sum_of_squares(&other);
            let squares = vec![squares as f32, (squares - f64::from(squares as f32)) as f32];
            let mut sums = vec![0.0; 71];
            activation::sum_rows(&other, &mut sums);
            [relu, tanh, of_relu, of_tanh, value, m, v, widened, squares, sums].concat()
        });
    }
}
