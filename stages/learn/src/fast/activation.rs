//! What follows a layer's sums, its gradient, and sums over rows.

use super::vector::widest;

widest! {
    /// max(x, 0) in place.
    pub fn relu(numbers: &mut [f32]) = relu_in
}

#[inline(always)]
fn relu_in<const ROWS: usize>(numbers: &mut [f32]) {
    for number in numbers {
        *number = number.max(0.0);
    }
}

widest! {
    /// Turns the gradient of a ReLU's output into that of its input: nothing passes where the output is 0.
    pub fn relu_gradient(output: &[f32], gradient: &mut [f32]) = relu_gradient_in
}

#[inline(always)]
fn relu_gradient_in<const ROWS: usize>(output: &[f32], gradient: &mut [f32]) {
    for (gradient, output) in gradient.iter_mut().zip(output) {
        *gradient = if *output > 0.0 { *gradient } else { 0.0 };
    }
}

widest! {
    /// The hyperbolic tangent in place, to the last bit or the one before it. Of our own, since that of the system
    /// differs between its versions.
    pub fn tanh(numbers: &mut [f32]) = tanh_in
}

/// tanh x = (e − 1) / (e + 1) with e = exp 2x = 2ⁿ·exp r, |r| ≤ ln 2 / 2, from the series of exp r − 1.
#[inline(always)]
fn tanh_in<const ROWS: usize>(numbers: &mut [f32]) {
    /// Beyond this the result is 1 in single precision.
    const FLAT: f64 = 10.0;
    /// Adding and subtracting it rounds to a whole number.
    const ROUND: f64 = 6_755_399_441_055_744.0;
    for number in numbers {
        let x = f64::from(*number).clamp(-FLAT, FLAT) * 2.0;
        let shifted = x.mul_add(std::f64::consts::LOG2_E, ROUND);
        let n = shifted - ROUND;
        let r = n.mul_add(-std::f64::consts::LN_2, x);
        let series = r.mul_add(1.0 / 3_628_800.0, 1.0 / 362_880.0);
        let series = series.mul_add(r, 1.0 / 40_320.0).mul_add(r, 1.0 / 5_040.0).mul_add(r, 1.0 / 720.0);
        let series = series.mul_add(r, 1.0 / 120.0).mul_add(r, 1.0 / 24.0).mul_add(r, 1.0 / 6.0);
        let minus_one = series.mul_add(r, 0.5).mul_add(r, 1.0) * r;
        // The low bits of `shifted` hold n; moved into the exponent they make 2ⁿ.
        let power = f64::from_bits(shifted.to_bits().wrapping_add(1023) << 52);
        let above = power.mul_add(minus_one, power - 1.0);
        let tanh = above / (above + 2.0);
        *number = if number.is_nan() { *number } else { tanh as f32 };
    }
}

widest! {
    /// Turns the gradient of a tangent's output into that of its input: times 1 − output².
    pub fn tanh_gradient(output: &[f32], gradient: &mut [f32]) = tanh_gradient_in
}

#[inline(always)]
fn tanh_gradient_in<const ROWS: usize>(output: &[f32], gradient: &mut [f32]) {
    for (gradient, output) in gradient.iter_mut().zip(output) {
        *gradient *= (-output).mul_add(*output, 1.0);
    }
}

widest! {
    /// The sum of rows as long as `sums`, written over it.
    pub fn sum_rows(rows: &[f32], sums: &mut [f32]) = sum_rows_in
}

#[inline(always)]
fn sum_rows_in<const ROWS: usize>(rows: &[f32], sums: &mut [f32]) {
    sums.fill(0.0);
    for row in rows.chunks_exact(sums.len()) {
        for (sum, number) in sums.iter_mut().zip(row) {
            *sum += number;
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
    fn every_width_gives_the_same_bits() {
        let numbers: Vec<f32> = (0..1003).map(|at| (at as f32 * 0.37).sin() * 4.0).collect();
        let (mut widest, mut plain) = (numbers.clone(), numbers.clone());
        tanh(&mut widest);
        tanh_in::<1>(&mut plain);
        assert_eq!(widest, plain);
        let (mut widest, mut plain) = ([0.0; 17], [0.0; 17]);
        sum_rows(&numbers, &mut widest);
        sum_rows_in::<1>(&numbers, &mut plain);
        assert_eq!(widest, plain);
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
}
