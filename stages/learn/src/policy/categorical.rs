//! One of several choices, as functions over tensors. A choice is a number from 0, kept as `f32` like other actions.

use tch::{Kind, Tensor};

/// The logarithm of the chosen probability: choices [batch, 1], result [batch].
pub fn log_prob(logits: &Tensor, choices: &Tensor) -> Tensor {
    logits.log_softmax(-1, Kind::Float).gather(1, &choices.to_kind(Kind::Int64), false).squeeze_dim(1)
}

/// −Σ p ln p, [batch].
pub fn entropy(logits: &Tensor) -> Tensor {
    let logs = logits.log_softmax(-1, Kind::Float);
    -(logs.exp() * logs).sum_dim_intlist(-1, false, None)
}

/// The mean of −ln p over the choices [batch, 1]; a scalar.
pub fn cross_entropy(logits: &Tensor, choices: &Tensor) -> Tensor {
    -log_prob(logits, choices).mean(Kind::Float)
}

/// The likeliest choice, [batch, 1].
pub fn likeliest(logits: &Tensor) -> Tensor {
    logits.argmax(-1, true).to_kind(Kind::Float)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn log_probability_and_entropy_equal_their_closed_forms() {
        crate::fast::prepare();
        // Probabilities 1/2, 1/4, 1/4.
        let logits = Tensor::from_slice(&[2.0_f32.ln(), 0.0, 0.0, 0.0, 0.0, 2.0_f32.ln()]).view([2, 3]);
        let choices = Tensor::from_slice(&[0.0_f32, 1.0]).view([2, 1]);
        let found = log_prob(&logits, &choices);
        assert_eq!(found.size(), [2]);
        for (row, wanted) in [0.5_f64.ln(), 0.25_f64.ln()].into_iter().enumerate() {
            assert!((found.double_value(&[row as i64]) - wanted).abs() < 1e-6);
        }
        let wanted = 1.5 * 2.0_f64.ln();
        assert!((entropy(&logits).double_value(&[1]) - wanted).abs() < 1e-6);
        let cross = cross_entropy(&logits, &choices).double_value(&[]);
        assert!((cross - wanted).abs() < 1e-6, "the mean of ln 2 and ln 4: {cross}");
        assert_eq!(likeliest(&logits).double_value(&[1, 0]), 2.0);
    }
}
