//! Independent normal distributions, as functions over tensors.

use std::f64::consts::PI;

use tch::Tensor;

/// log N(x; μ, σ²) summed over the last dimension.
pub fn log_prob(mean: &Tensor, log_std: &Tensor, x: &Tensor) -> Tensor {
    let standard = (x - mean) / log_std.exp();
    (standard.square() * -0.5 - log_std - 0.5 * (2.0 * PI).ln()).sum_dim_intlist(-1, false, None)
}

/// ½ + ½ ln 2π + ln σ summed over the last dimension, for each row of `mean`.
pub fn entropy(mean: &Tensor, log_std: &Tensor) -> Tensor {
    let each: Tensor = log_std + (0.5 + 0.5 * (2.0 * PI).ln());
    each.expand_as(mean).sum_dim_intlist(-1, false, None)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn log_probability_and_entropy_equal_their_closed_forms() {
        crate::fast::prepare();
        let mean = Tensor::from_slice(&[0.5_f32, -1.0, 0.0, 2.0]).view([2, 2]);
        let log_std = Tensor::from_slice(&[0.0_f32, -0.5]);
        let x = Tensor::from_slice(&[0.0_f32, -1.5, 1.0, 2.0]).view([2, 2]);
        let density =
            |x: f64, m: f64, s: f64| (-(x - m).powi(2) / (2.0 * s * s)).exp() / (s * (2.0 * PI).sqrt());
        let s = (-0.5_f64).exp();
        let wanted = [
            density(0.0, 0.5, 1.0).ln() + density(-1.5, -1.0, s).ln(),
            density(1.0, 0.0, 1.0).ln() + density(2.0, 2.0, s).ln(),
        ];
        let found = log_prob(&mean, &log_std, &x);
        for (row, wanted) in wanted.into_iter().enumerate() {
            assert!((found.double_value(&[row as i64]) - wanted).abs() < 1e-6);
        }
        // ½ ln(2πeσ²) for each dimension.
        let wanted = 0.5 * (2.0 * PI * std::f64::consts::E).ln() * 2.0 - 0.5;
        let found = entropy(&mean, &log_std);
        assert_eq!(found.size(), [2]);
        assert!((found.double_value(&[1]) - wanted).abs() < 1e-6);
    }
}
