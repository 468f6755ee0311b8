//! The distribution over actions for one observation, from the raw outputs of the network: log-density, entropy, draws
//! and gradients, in double precision and with equal bits on every machine.
//!
//! Gradients are written down by hand instead of derived by a library: the formulas are few, and the functions in them
//! must be those of [`dril_stage_api::math`]. Nothing here allocates.

use rand::Rng;

use super::{beta, categorical, gaussian};

/// One row of what a network's head gave: the parameters of a distribution over actions.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Row<'a> {
    /// Independent normal distributions.
    Gaussian {
        /// Means, one for each dimension.
        mean: &'a [f32],
        /// Logarithms of the standard deviations: a parameter that all rows share.
        log_std: &'a [f32],
    },
    /// Independent Beta distributions over [0, 1] with α = softplus(u) + 1 and β = softplus(w) + 1.
    Beta {
        /// One for each dimension.
        u: &'a [f32],
        /// One for each dimension.
        w: &'a [f32],
    },
    /// One of several choices.
    Categorical {
        /// Logarithms of the probabilities, up to a constant.
        logits: &'a [f32],
    },
}

/// What a row's gradients are added to. Which slices are used depends on the family; the others may be empty.
#[derive(Debug)]
pub struct RowGradient<'a> {
    /// For the head's first output: means, u or logits.
    pub first: &'a mut [f32],
    /// For its second: w.
    pub second: &'a mut [f32],
    /// For the parameter that all rows share: `log_std`.
    pub shared: &'a mut [f64],
}

/// How much the two quantities of a row weigh in what is minimised: its derivatives for them.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Weights {
    /// For the log-density of the row's sample.
    pub log_prob: f64,
    /// For the row's entropy.
    pub entropy: f64,
}

/// Adds in double precision, rounded once.
pub(super) fn add(into: &mut f32, value: f64) {
    *into = (f64::from(*into) + value) as f32;
}

impl Row<'_> {
    /// The log-density of a sample, summed over dimensions; of a choice the logarithm of its probability. In the
    /// sample's own scale: the Beta's stretch to [-1, 1] is a constant that no ratio sees.
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

    /// The mean of each dimension, in the sample's scale, into `sample`; of choices the likeliest.
    pub fn mean(&self, sample: &mut [f32]) {
        match *self {
            Self::Gaussian { mean, .. } => sample.copy_from_slice(mean),
            Self::Beta { u, w } => beta::mean(u, w, sample),
            Self::Categorical { logits } => sample[0] = categorical::likeliest(logits),
        }
    }

    /// Draws a sample from the stream into `sample`.
    pub fn sample<R: Rng + ?Sized>(&self, stream: &mut R, sample: &mut [f32]) {
        match *self {
            Self::Gaussian { mean, log_std } => gaussian::sample(mean, log_std, stream, sample),
            Self::Beta { u, w } => beta::sample(u, w, stream, sample),
            Self::Categorical { logits } => sample[0] = categorical::sample(logits, stream),
        }
    }

    /// Adds `weights.log_prob` · d log_prob(sample) + `weights.entropy` · d entropy, for the raw outputs and the shared
    /// parameter.
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

    /// What behaviour cloning lowers: the mean over dimensions of the squared error of the mean action, both clamped to
    /// [-1, 1] as the environment does it; of choices −ln p. `demonstrated` is in the environment's scale.
    pub fn cloning_loss(&self, demonstrated: &[f32]) -> f64 {
        match *self {
            Self::Gaussian { mean, .. } => squared_error(means(mean), demonstrated),
            Self::Beta { u, w } => squared_error(beta::mean_actions(u, w), demonstrated),
            Self::Categorical { .. } => -self.log_prob(demonstrated),
        }
    }

    /// Adds `weight` times the gradient of [`Row::cloning_loss`] for the raw outputs. A mean beyond [-1, 1] has none.
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

/// `weight` times its derivatives for the predictions.
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
