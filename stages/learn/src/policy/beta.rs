//! Independent Beta distributions over [0, 1], one per action dimension: closed forms for one row, in double precision.
//!
//! The network outputs u and w; α = softplus(u) + 1 and β = softplus(w) + 1 exceed 1, so that the density has one mode and
//! vanishes at both ends. Single precision is not enough: at concentrations of 1e5 its log-density is off by as much as
//! the clip range of an update.

use dril_stage_api::{draw, math};
use rand::Rng;

use super::weights::{Weights, add};

/// Minimum distance of samples from 0 and 1: there, the log-density is not finite, and in single precision a sample can
/// round to them.
pub const EDGE: f32 = 1e-6;

/// One dimension's distribution.
#[derive(Clone, Copy)]
struct Shapes {
    /// α − 1 and β − 1, without the rounding error of adding 1.
    above: (f64, f64),
    alpha: f64,
    beta: f64,
    /// dα/du and dβ/dw.
    slopes: (f64, f64),
}

impl Shapes {
    fn new(u: f32, w: f32) -> Self {
        let (u, w) = (f64::from(u), f64::from(w));
        let above = (math::softplus(u), math::softplus(w));
        let slopes = (math::logistic(u), math::logistic(w));
        Self { above, alpha: above.0 + 1.0, beta: above.1 + 1.0, slopes }
    }

    /// α / (α + β).
    fn mean(self) -> f64 {
        self.alpha / (self.alpha + self.beta)
    }

    /// (α−1) ln x + (β−1) ln(1−x) − ln B(α, β).
    fn log_prob(self, x: f32) -> f64 {
        let (left, right) = logarithms(x);
        self.above.0 * left + self.above.1 * right - math::ln_beta(self.alpha, self.beta)
    }

    /// ln B(α, β) − (α−1) (ψ(α) − ψ(α+β)) − (β−1) (ψ(β) − ψ(α+β)).
    fn entropy(self) -> f64 {
        let (left, right) = self.mean_logarithms();
        math::ln_beta(self.alpha, self.beta) - self.above.0 * left - self.above.1 * right
    }

    /// The expectations of ln x and ln(1 − x): ψ(α) − ψ(α+β) and ψ(β) − ψ(α+β).
    fn mean_logarithms(self) -> (f64, f64) {
        let both = math::digamma(self.alpha + self.beta);
        (math::digamma(self.alpha) - both, math::digamma(self.beta) - both)
    }

    /// The gradients of the weighted sum of log-density and entropy with respect to u and w.
    fn gradient(self, x: f32, weights: Weights) -> (f64, f64) {
        let (left, right) = logarithms(x);
        let (mean_left, mean_right) = self.mean_logarithms();
        let mut by_alpha = weights.log_prob * (left - mean_left);
        let mut by_beta = weights.log_prob * (right - mean_right);
        if weights.entropy != 0.0 {
            // −(α−1) ψ′(α) + (α+β−2) ψ′(α+β), and the same for β.
            let both = (self.above.0 + self.above.1) * math::trigamma(self.alpha + self.beta);
            by_alpha += weights.entropy * (both - self.above.0 * math::trigamma(self.alpha));
            by_beta += weights.entropy * (both - self.above.1 * math::trigamma(self.beta));
        }
        (by_alpha * self.slopes.0, by_beta * self.slopes.1)
    }
}

/// ln x and ln(1 − x).
fn logarithms(x: f32) -> (f64, f64) {
    let x = f64::from(x);
    (math::ln(x), math::ln_1p(-x))
}

fn shapes<'a>(u: &'a [f32], w: &'a [f32]) -> impl Iterator<Item = Shapes> + 'a {
    u.iter().zip(w).map(|(&u, &w)| Shapes::new(u, w))
}

/// The log-density of a sample, summed over dimensions.
pub(super) fn log_prob(u: &[f32], w: &[f32], sample: &[f32]) -> f64 {
    shapes(u, w).zip(sample).map(|(shapes, &x)| shapes.log_prob(x)).sum()
}

/// The differential entropy, summed over dimensions.
pub(super) fn entropy(u: &[f32], w: &[f32]) -> f64 {
    shapes(u, w).map(Shapes::entropy).sum()
}

/// The mean of each dimension, clamped away from the ends.
pub(super) fn mean(u: &[f32], w: &[f32], sample: &mut [f32]) {
    for (shapes, x) in shapes(u, w).zip(sample) {
        *x = inside(shapes.mean());
    }
}

/// Samples each dimension, clamped away from the ends. NaN shapes (of a diverged network) give NaN, which the next update
/// reports with its cause.
pub(super) fn sample<R: Rng + ?Sized>(u: &[f32], w: &[f32], rng: &mut R, sample: &mut [f32]) {
    for (shapes, x) in shapes(u, w).zip(sample) {
        *x = inside(draw::beta(rng, shapes.alpha, shapes.beta));
    }
}

fn inside(x: f64) -> f32 {
    (x as f32).clamp(EDGE, 1.0 - EDGE)
}

/// Adds the gradients with respect to u and w.
pub(super) fn add_gradient(
    (u, w): (&[f32], &[f32]),
    sample: &[f32],
    weights: Weights,
    (into_u, into_w): (&mut [f32], &mut [f32]),
) {
    let into = into_u.iter_mut().zip(into_w);
    for ((shapes, &x), (into_u, into_w)) in shapes(u, w).zip(sample).zip(into) {
        let (by_u, by_w) = shapes.gradient(x, weights);
        add(into_u, by_u);
        add(into_w, by_w);
    }
}

/// The means in [−1, 1].
pub(super) fn mean_actions<'a>(u: &'a [f32], w: &'a [f32]) -> impl Iterator<Item = f64> + 'a {
    // 2α / (α + β) − 1 without cancellation.
    shapes(u, w).map(|s| (s.above.0 - s.above.1) / (s.alpha + s.beta))
}

/// Adds the gradients with respect to u and w of a function of the mean actions (see [`mean_actions`]), given its
/// gradients `slopes` with respect to those.
pub(super) fn add_mean_gradient(
    (u, w): (&[f32], &[f32]),
    slopes: impl Iterator<Item = f64>,
    (into_u, into_w): (&mut [f32], &mut [f32]),
) {
    let into = into_u.iter_mut().zip(into_w);
    for ((s, slope), (into_u, into_w)) in shapes(u, w).zip(slopes).zip(into) {
        let sum = s.alpha + s.beta;
        let scale = 2.0 * slope / (sum * sum);
        add(into_u, scale * s.beta * s.slopes.0);
        add(into_w, -scale * s.alpha * s.slopes.1);
    }
}
