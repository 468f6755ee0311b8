//! Diagonal Gaussian distributions: closed forms for one row, in double precision.
//!
//! With z = (x − μ) / σ: ln p = Σ −½ z² − ln σ − ½ ln 2π, d ln p / dμ = z / σ, d ln p / d ln σ = z² − 1; the entropy is
//! Σ ln σ + ½ + ½ ln 2π.

use dril_stage_api::{draw, math};
use rand::Rng;

use super::weights::{Weights, add};

/// ½ ln 2π.
const HALF_LN_TAU: f64 = 0.918_938_533_204_672_8;

/// The log-density of a sample, summed over dimensions.
pub(super) fn log_prob(mean: &[f32], log_std: &[f32], sample: &[f32]) -> f64 {
    let terms = mean.iter().zip(log_std).zip(sample).map(|((&mean, &log_std), &x)| {
        let z = standard(mean, log_std, x);
        -0.5 * z * z - f64::from(log_std) - HALF_LN_TAU
    });
    terms.sum()
}

/// The differential entropy, summed over dimensions.
pub(super) fn entropy(log_std: &[f32]) -> f64 {
    log_std.iter().map(|&log_std| f64::from(log_std) + 0.5 + HALF_LN_TAU).sum()
}

/// Samples each dimension.
pub(super) fn sample<R: Rng + ?Sized>(mean: &[f32], log_std: &[f32], rng: &mut R, sample: &mut [f32]) {
    for ((&mean, &log_std), x) in mean.iter().zip(log_std).zip(sample) {
        *x = (f64::from(mean) + math::exp(f64::from(log_std)) * draw::normal(rng)) as f32;
    }
}

/// Adds the gradients with respect to the means and the log standard deviations.
pub(super) fn add_gradient(
    (mean, log_std): (&[f32], &[f32]),
    sample: &[f32],
    weights: Weights,
    (into_mean, into_log_std): (&mut [f32], &mut [f64]),
) {
    let into = into_mean.iter_mut().zip(into_log_std);
    for (((&mean, &log_std), &x), (into_mean, into_log_std)) in mean.iter().zip(log_std).zip(sample).zip(into)
    {
        let z = standard(mean, log_std, x);
        add(into_mean, weights.log_prob * z * math::exp(-f64::from(log_std)));
        *into_log_std += weights.log_prob * (z * z - 1.0) + weights.entropy;
    }
}

fn standard(mean: f32, log_std: f32, x: f32) -> f64 {
    (f64::from(x) - f64::from(mean)) * math::exp(-f64::from(log_std))
}
