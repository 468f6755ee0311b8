//! Independent Beta distributions over [0, 1], as functions over tensors.

use tch::Tensor;

/// Samples are kept this far from 0 and 1: at the ends the log-density is not finite, and in single precision a sample
/// can round to them.
pub const EDGE: f32 = 1e-6;

/// softplus(x) + 1: a shape parameter of more than 1, so that the density has one peak and vanishes at both ends.
pub fn shape(x: &Tensor) -> Tensor {
    x.softplus() + 1.0
}

/// α / (α + β).
pub fn mean(alpha: &Tensor, beta: &Tensor) -> Tensor {
    alpha / (alpha + beta)
}

fn log_beta_function(alpha: &Tensor, beta: &Tensor) -> Tensor {
    alpha.lgamma() + beta.lgamma() - (alpha + beta).lgamma()
}

/// (α−1) ln x + (β−1) ln(1−x) − ln B(α, β) summed over the last dimension.
pub fn log_prob(alpha: &Tensor, beta: &Tensor, x: &Tensor) -> Tensor {
    let left: Tensor = (alpha - 1.0) * x.log();
    let right: Tensor = (beta - 1.0) * (-x).log1p();
    (left + right - log_beta_function(alpha, beta)).sum_dim_intlist(-1, false, None)
}

/// ln B(α, β) − (α−1) ψ(α) − (β−1) ψ(β) + (α+β−2) ψ(α+β) summed over the last dimension.
pub fn entropy(alpha: &Tensor, beta: &Tensor) -> Tensor {
    let sum = alpha + beta;
    let each =
        log_beta_function(alpha, beta) - (alpha - 1.0) * alpha.digamma() - (beta - 1.0) * beta.digamma()
            + (&sum - 2.0) * sum.digamma();
    each.sum_dim_intlist(-1, false, None)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn row(values: &[f64]) -> Tensor {
        Tensor::from_slice(values).view([1, values.len() as i64])
    }

    #[test]
    fn log_probability_and_entropy_equal_their_closed_forms() {
        crate::fast::prepare();
        // Beta(2, 3) has density 12 x (1−x)², Beta(1, 1) is uniform.
        let (alpha, beta) = (row(&[2.0, 1.0]), row(&[3.0, 1.0]));
        let found = log_prob(&alpha, &beta, &row(&[0.3, 0.9])).double_value(&[0]);
        assert!((found - (12.0 * 0.3 * 0.49_f64).ln()).abs() < 1e-12, "{found}");
        // ψ(2) = 1−γ, ψ(3) = 3/2−γ, ψ(5) = 25/12−γ, so the entropy of Beta(2, 3) is −ln 12 + 9/4.
        let wanted = -(12.0_f64).ln() + 2.25 - 1.0 + 1.0;
        let gamma = 0.577_215_664_901_532_9;
        let closed = -(12.0_f64).ln() - (1.0 - gamma) - 2.0 * (1.5 - gamma) + 3.0 * (25.0 / 12.0 - gamma);
        assert!((closed - wanted).abs() < 1e-12);
        let found = entropy(&alpha, &beta).double_value(&[0]);
        assert!((found - closed).abs() < 1e-9, "{found} {closed}");
    }

    #[test]
    fn the_density_integrates_to_one_and_its_mean_is_the_mean() {
        crate::fast::prepare();
        let n = 20_000;
        let x = (Tensor::arange(n, (tch::Kind::Double, tch::Device::Cpu)) + 0.5) / n as f64;
        let (alpha, beta) = (row(&[1.7]), row(&[4.2]));
        let density = log_prob(&alpha, &beta, &x.view([n, 1])).exp() / n as f64;
        assert!((density.sum(tch::Kind::Double).double_value(&[]) - 1.0).abs() < 1e-6);
        let first = (density * x).sum(tch::Kind::Double).double_value(&[]);
        assert!((first - mean(&alpha, &beta).double_value(&[0, 0])).abs() < 1e-6);
    }

    #[test]
    fn shapes_exceed_one_and_log_probabilities_at_the_edges_are_finite() {
        crate::fast::prepare();
        let shapes = shape(&row(&[-50.0, 0.0, 50.0]));
        assert!(shapes.min().double_value(&[]) >= 1.0);
        let ends = Tensor::from_slice(&[EDGE, 1.0 - EDGE]).view([2, 1]);
        let steep = Tensor::from_slice(&[60.0_f32]);
        assert!(log_prob(&steep, &steep, &ends).isfinite().all().int64_value(&[]) == 1);
    }
}
