//! What follows a layer's sums, its gradient, and sums over rows.

use super::vector::{Kernel, LANES, Simd, load_some, run, store_some};

/// max(x, 0) in place; NaN stays.
pub fn relu(numbers: &mut [f32]) {
    run(Relu(numbers));
}

struct Relu<'a>(&'a mut [f32]);

impl Kernel for Relu<'_> {
    #[inline(always)]
    fn run<S: Simd>(self, simd: S) {
        for numbers in self.0.chunks_mut(LANES) {
            store_some(simd, simd.relu(load_some(simd, numbers)), numbers);
        }
    }
}

/// Turns the gradient of a ReLU's output into that of its input: nothing passes where the output is 0.
pub fn relu_gradient(output: &[f32], gradient: &mut [f32]) {
    run(ReluGradient { output, gradient });
}

struct ReluGradient<'a> {
    output: &'a [f32],
    gradient: &'a mut [f32],
}

impl Kernel for ReluGradient<'_> {
    #[inline(always)]
    fn run<S: Simd>(self, simd: S) {
        for (output, gradient) in self.output.chunks(LANES).zip(self.gradient.chunks_mut(LANES)) {
            let passed = simd.where_positive(load_some(simd, output), load_some(simd, gradient));
            store_some(simd, passed, gradient);
        }
    }
}

/// The hyperbolic tangent in place, to the last bit or the one before it. Of our own, since that of the system
/// differs between its versions.
pub fn tanh(numbers: &mut [f32]) {
    run(Tanh(numbers));
}

struct Tanh<'a>(&'a mut [f32]);

impl Kernel for Tanh<'_> {
    #[inline(always)]
    fn run<S: Simd>(self, simd: S) {
        for numbers in self.0.chunks_mut(LANES) {
            let x = load_some(simd, numbers);
            let [first, last] = simd.widen(x);
            let tanh = simd.narrow([tanh_of(simd, first), tanh_of(simd, last)]);
            store_some(simd, simd.nan_or(x, tanh), numbers);
        }
    }
}

/// tanh x = (e − 1) / (e + 1) with e = exp 2x = 2ⁿ·exp r, |r| ≤ ln 2 / 2, from the series of exp r − 1.
#[inline(always)]
fn tanh_of<S: Simd>(simd: S, x: S::D) -> S::D {
    /// Beyond this the result is 1 in single precision.
    const FLAT: f64 = 10.0;
    /// Adding and subtracting it rounds to a whole number.
    const ROUND: f64 = 6_755_399_441_055_744.0;
    /// 1 / 9! down to 1 / 2!, and 1.
    const SERIES: [f64; 9] = [
        1.0 / 362_880.0,
        1.0 / 40_320.0,
        1.0 / 5_040.0,
        1.0 / 720.0,
        1.0 / 120.0,
        1.0 / 24.0,
        1.0 / 6.0,
        0.5,
        1.0,
    ];
    let number = |number: f64| simd.splat_d(number);
    let x = simd.mul_d(simd.clamp_d(x, FLAT), number(2.0));
    let shifted = simd.mul_add_d(x, number(std::f64::consts::LOG2_E), number(ROUND));
    let n = simd.sub_d(shifted, number(ROUND));
    let r = simd.mul_add_d(n, number(-std::f64::consts::LN_2), x);
    let mut series = number(1.0 / 3_628_800.0);
    for coefficient in SERIES {
        series = simd.mul_add_d(series, r, number(coefficient));
    }
    let minus_one = simd.mul_d(series, r);
    // The low bits of `shifted` hold n; moved into the exponent they make 2ⁿ.
    let power = simd.power_of_two_d(shifted);
    let above = simd.mul_add_d(power, minus_one, simd.sub_d(power, number(1.0)));
    simd.div_d(above, simd.add_d(above, number(2.0)))
}

/// Turns the gradient of a tangent's output into that of its input: times 1 − output².
pub fn tanh_gradient(output: &[f32], gradient: &mut [f32]) {
    run(TanhGradient { output, gradient });
}

struct TanhGradient<'a> {
    output: &'a [f32],
    gradient: &'a mut [f32],
}

impl Kernel for TanhGradient<'_> {
    #[inline(always)]
    fn run<S: Simd>(self, simd: S) {
        for (output, gradient) in self.output.chunks(LANES).zip(self.gradient.chunks_mut(LANES)) {
            let output = load_some(simd, output);
            let minus = simd.mul(output, simd.splat(-1.0));
            let slope = simd.mul_add(minus, output, simd.splat(1.0));
            store_some(simd, simd.mul(load_some(simd, gradient), slope), gradient);
        }
    }
}

/// The sum of rows as long as `sums`, written over it: row after row, from 0.
pub fn sum_rows(rows: &[f32], sums: &mut [f32]) {
    sums.fill(0.0);
    run(SumRows { rows, sums });
}

struct SumRows<'a> {
    rows: &'a [f32],
    sums: &'a mut [f32],
}

/// Vectors of sums that are held in registers while the rows pass by.
const HELD: usize = 4;

impl Kernel for SumRows<'_> {
    #[inline(always)]
    fn run<S: Simd>(self, simd: S) {
        let line = self.sums.len();
        for (at, sums) in self.sums.chunks_mut(HELD * LANES).enumerate() {
            let (at, width) = (at * HELD * LANES, sums.len());
            let mut held = [simd.splat(0.0); HELD];
            for row in self.rows.chunks_exact(line) {
                let row = &row[at..at + width];
                match row.first_chunk::<{ HELD * LANES }>() {
                    Some(row) => {
                        for (held, numbers) in held.iter_mut().zip(row.as_chunks().0) {
                            *held = simd.add(*held, simd.load(numbers));
                        }
                    }
                    None => {
                        for (held, numbers) in held.iter_mut().zip(row.chunks(LANES)) {
                            *held = simd.add(*held, load_some(simd, numbers));
                        }
                    }
                }
            }
            for (sums, held) in sums.chunks_mut(LANES).zip(held) {
                store_some(simd, held, sums);
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_tangent_is_that_of_double_precision() {
        let inputs: Vec<f32> = (-120_000..120_000).map(|at| at as f32 * 1e-4).collect();
        let inputs = [inputs, vec![0.0, 1e-30, -1e-7, 3e-5, f32::INFINITY, f32::NEG_INFINITY]].concat();
        let mut outputs = inputs.clone();
        tanh(&mut outputs);
        for (input, output) in inputs.iter().zip(outputs) {
            let exact = f64::from(*input).tanh();
            let apart = (f64::from(output) - exact).abs();
            assert!(apart <= 1.2e-7 * exact.abs(), "tanh {input} is {exact}, not {output}");
        }
        let mut odd = [f32::NAN, -0.5, 0.5];
        tanh(&mut odd);
        assert!(odd[0].is_nan() && odd[1] == -odd[2]);
    }

    #[test]
    fn gradients_pass_where_the_function_is_not_flat() {
        let (mut output, mut gradient) = ([-2.0, 0.0, 3.0], [5.0, 5.0, 5.0]);
        relu(&mut output);
        relu_gradient(&output, &mut gradient);
        assert_eq!((output, gradient), ([0.0, 0.0, 3.0], [0.0, 0.0, 5.0]));
        let mut gradient = [1.0, 2.0];
        tanh_gradient(&[0.5, 1.0], &mut gradient);
        assert_eq!(gradient, [0.75, 0.0]);
    }

    #[test]
    fn a_relu_does_not_hide_what_is_not_a_number() {
        let mut numbers = [f32::NAN, -1.0];
        relu(&mut numbers);
        assert!(numbers[0].is_nan() && numbers[1] == 0.0);
    }

    #[test]
    fn rows_add_up_column_by_column() {
        let rows: Vec<f32> = (0..3 * 150).map(|at| at as f32).collect();
        let mut sums = vec![9.0; 150];
        sum_rows(&rows, &mut sums);
        assert!(sums.iter().enumerate().all(|(at, sum)| *sum == (3 * at + 450) as f32));
    }
}
