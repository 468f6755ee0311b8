//! The action distribution for one observation, from the raw outputs of the network: log-density, entropy, samples and
//! gradients, in double precision and with the same bits on every machine.
//!
//! Gradients are hand-written instead of by autograd: there are few formulas, and they must use the functions of
//! [`dril_stage_api::math`]. Nothing here allocates.

use rand::Rng;

use super::weights::{Weights, add};
use super::{beta, categorical, gaussian};

/// One row of the head's outputs: the parameters of an action distribution.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Row<'a> {
    /// Diagonal Gaussian.
    Gaussian {
        /// Means, one per dimension.
        mean: &'a [f32],
        /// Log standard deviations, shared by all rows.
        log_std: &'a [f32],
    },
    /// Independent Beta distributions over [0, 1] with α = softplus(u) + 1 and β = softplus(w) + 1.
    Beta {
        /// One per dimension.
        u: &'a [f32],
        /// One per dimension.
        w: &'a [f32],
    },
    /// Categorical.
    Categorical {
        /// Unnormalised log-probabilities.
        logits: &'a [f32],
    },
}

/// Where the gradients of a row are accumulated. Which slices are used depends on the family; the others may be empty.
#[derive(Debug)]
pub struct RowGradient<'a> {
    /// With respect to the head's first output: means, u or logits.
    pub first: &'a mut [f32],
    /// With respect to its second output: w.
    pub second: &'a mut [f32],
    /// With respect to the shared parameter: `log_std`.
    pub shared: &'a mut [f64],
}

impl Row<'_> {
    /// The log-density of a sample, summed over dimensions; for a discrete action, its log-probability. In the sample's own
    /// range: the Beta's rescaling to [-1, 1] is a constant that cancels in ratios.
    pub fn log_prob(&self, sample: &[f32]) -> f64 {
        match *self {
            Self::Gaussian { mean, log_std } => gaussian::log_prob(mean, log_std, sample),
            Self::Beta { u, w } => beta::log_prob(u, w, sample),
            Self::Categorical { logits } => categorical::log_prob(logits, sample[0]),
        }
    }

    /// The entropy in nats, summed over dimensions.
    pub fn entropy(&self) -> f64 {
        match *self {
            Self::Gaussian { log_std, .. } => gaussian::entropy(log_std),
            Self::Beta { u, w } => beta::entropy(u, w),
            Self::Categorical { logits } => categorical::entropy(logits),
        }
    }

    /// Writes the mean of each dimension, in the sample's range, to `sample`; the most likely discrete action.
    pub fn mean(&self, sample: &mut [f32]) {
        match *self {
            Self::Gaussian { mean, .. } => sample.copy_from_slice(mean),
            Self::Beta { u, w } => beta::mean(u, w, sample),
            Self::Categorical { logits } => sample[0] = categorical::likeliest(logits),
        }
    }

    /// Writes a sample drawn from the stream to `sample`.
    pub fn sample<R: Rng + ?Sized>(&self, stream: &mut R, sample: &mut [f32]) {
        match *self {
            Self::Gaussian { mean, log_std } => gaussian::sample(mean, log_std, stream, sample),
            Self::Beta { u, w } => beta::sample(u, w, stream, sample),
            Self::Categorical { logits } => sample[0] = categorical::sample(logits, stream),
        }
    }

    /// Adds `weights.log_prob` · d log_prob(sample) + `weights.entropy` · d entropy, with respect to the raw outputs and the
    /// shared parameter.
    pub fn add_gradient(&self, sample: &[f32], weights: Weights, into: RowGradient<'_>) {
        let RowGradient { first, second, shared } = into;
        match *self {
            Self::Gaussian { mean, log_std } => {
                gaussian::add_gradient((mean, log_std), sample, weights, (first, shared));
            }
            Self::Beta { u, w } => beta::add_gradient((u, w), sample, weights, (first, second)),
            Self::Categorical { logits } => categorical::add_gradient(logits, sample[0], weights, first),
        }
    }

    /// The loss of behaviour cloning: the mean squared error of the mean action over dimensions, both clamped to [-1, 1] as
    /// in the environment; −ln p for a discrete action. `demonstrated` is in the environment's range.
    pub fn cloning_loss(&self, demonstrated: &[f32]) -> f64 {
        match *self {
            Self::Gaussian { mean, .. } => squared_error(means(mean), demonstrated),
            Self::Beta { u, w } => squared_error(beta::mean_actions(u, w), demonstrated),
            Self::Categorical { .. } => -self.log_prob(demonstrated),
        }
    }

    /// Adds `weight` times the gradient of [`Row::cloning_loss`] with respect to the raw outputs. It is 0 for a mean outside
    /// [-1, 1].
    pub fn add_cloning_gradient(&self, demonstrated: &[f32], weight: f64, into: RowGradient<'_>) {
        let RowGradient { first, second, shared } = into;
        match *self {
            Self::Gaussian { mean, .. } => {
                for (into, slope) in first.iter_mut().zip(error_slopes(means(mean), demonstrated, weight)) {
                    add(into, slope);
                }
            }
            Self::Beta { u, w } => {
                let slopes = error_slopes(beta::mean_actions(u, w), demonstrated, weight);
                beta::add_mean_gradient((u, w), slopes, (first, second));
            }
            Self::Categorical { .. } => {
                let weights = Weights { log_prob: -weight, entropy: 0.0 };
                self.add_gradient(demonstrated, weights, RowGradient { first, second, shared });
            }
        }
    }
}

fn means(mean: &[f32]) -> impl Iterator<Item = f64> + '_ {
    mean.iter().map(|&mean| f64::from(mean))
}

fn clamped(action: f32) -> f64 {
    f64::from(action).clamp(-1.0, 1.0)
}

/// The mean squared error of actions, both clamped to [-1, 1].
fn squared_error(predicted: impl Iterator<Item = f64>, demonstrated: &[f32]) -> f64 {
    let errors = predicted.zip(demonstrated).map(|(predicted, &demonstrated)| {
        let error = predicted.clamp(-1.0, 1.0) - clamped(demonstrated);
        error * error
    });
    errors.sum::<f64>() / demonstrated.len() as f64
}

/// `weight` times its derivatives with respect to the predictions.
fn error_slopes(
    predicted: impl Iterator<Item = f64>,
    demonstrated: &[f32],
    weight: f64,
) -> impl Iterator<Item = f64> {
    let scale = 2.0 * weight / demonstrated.len() as f64;
    predicted.zip(demonstrated).map(move |(predicted, &demonstrated)| {
        let inside = (-1.0..=1.0).contains(&predicted);
        if inside { scale * (predicted - clamped(demonstrated)) } else { 0.0 }
    })
}

#[cfg(test)]
#[path = "distribution_tests.rs"]
mod tests;
