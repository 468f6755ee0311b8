//! The policy families' formulas over tensors of libtorch: what tests hold the closed forms of [`super::distribution`] against,
//! by libtorch's autograd in double precision.

use std::f64::consts::PI;

use tch::{Kind, Tensor};

/// log N(x; μ, σ²) summed over the last dimension.
pub fn gaussian_log_prob(mean: &Tensor, log_std: &Tensor, x: &Tensor) -> Tensor {
    let standard = (x - mean) / log_std.exp();
    (standard.square() * -0.5 - log_std - 0.5 * (2.0 * PI).ln()).sum_dim_intlist(-1, false, None)
}

/// ½ + ½ ln 2π + ln σ summed over the last dimension, for each row of `mean`.
pub fn gaussian_entropy(mean: &Tensor, log_std: &Tensor) -> Tensor {
    let each: Tensor = log_std + (0.5 + 0.5 * (2.0 * PI).ln());
    each.expand_as(mean).sum_dim_intlist(-1, false, None)
}

/// softplus(x) + 1: a shape parameter of the Beta.
pub fn beta_shape(x: &Tensor) -> Tensor {
    x.softplus() + 1.0
}

/// α / (α + β).
pub fn beta_mean(alpha: &Tensor, beta: &Tensor) -> Tensor {
    alpha / (alpha + beta)
}

fn log_beta_function(alpha: &Tensor, beta: &Tensor) -> Tensor {
    alpha.lgamma() + beta.lgamma() - (alpha + beta).lgamma()
}

/// (α−1) ln x + (β−1) ln(1−x) − ln B(α, β) summed over the last dimension.
pub fn beta_log_prob(alpha: &Tensor, beta: &Tensor, x: &Tensor) -> Tensor {
    let left: Tensor = (alpha - 1.0) * x.log();
    let right: Tensor = (beta - 1.0) * (-x).log1p();
    (left + right - log_beta_function(alpha, beta)).sum_dim_intlist(-1, false, None)
}

/// ln B(α, β) − (α−1) ψ(α) − (β−1) ψ(β) + (α+β−2) ψ(α+β) summed over the last dimension.
pub fn beta_entropy(alpha: &Tensor, beta: &Tensor) -> Tensor {
    let sum = alpha + beta;
    let each =
        log_beta_function(alpha, beta) - (alpha - 1.0) * alpha.digamma() - (beta - 1.0) * beta.digamma()
            + (&sum - 2.0) * sum.digamma();
    each.sum_dim_intlist(-1, false, None)
}

/// The logarithm of the chosen probability: choices [batch, 1], result [batch].
pub fn categorical_log_prob(logits: &Tensor, choices: &Tensor) -> Tensor {
    logits.log_softmax(-1, logits.kind()).gather(1, &choices.to_kind(Kind::Int64), false).squeeze_dim(1)
}

/// −Σ p ln p, [batch].
pub fn categorical_entropy(logits: &Tensor) -> Tensor {
    let logs = logits.log_softmax(-1, logits.kind());
    -(logs.exp() * logs).sum_dim_intlist(-1, false, None)
}

/// The mean of −ln p over the choices [batch, 1]; a scalar.
pub fn categorical_cross_entropy(logits: &Tensor, choices: &Tensor) -> Tensor {
    -categorical_log_prob(logits, choices).mean(logits.kind())
}

/// The mean squared error between actions, both clamped to [-1, 1]; a scalar.
pub fn action_loss(predicted: &Tensor, demonstrated: &Tensor) -> Tensor {
    (predicted.clamp(-1.0, 1.0) - demonstrated.clamp(-1.0, 1.0)).square().mean(predicted.kind())
}
