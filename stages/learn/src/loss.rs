//! The losses of proximal policy optimisation and of advantage actor-critic as pure functions over the samples of a
//! minibatch, with their gradients for each sample's log-probability, entropy and value.
//!
//! All sums are in double precision and in the order of the samples. Where a minimum, a maximum or a clamp has a corner,
//! the gradient is the one that PyTorch passes: half to each side of equal arguments, all of it on the border of a
//! clamp.

use dril_stage_api::math;

/// What a loss is computed from; one entry for each sample of the minibatch.
#[derive(Clone, Copy, Debug)]
pub struct LossInputs<'a> {
    /// Log-densities of the actions as the policy has them now.
    pub log_probs: &'a [f64],
    /// Its entropies, in nats.
    pub entropies: &'a [f64],
    /// State values as the critic has them now.
    pub values: &'a [f32],
    /// Log-densities of the actions when they were drawn.
    pub old_log_probs: &'a [f64],
    /// State values when they were drawn.
    pub old_values: &'a [f32],
    /// Advantages, normalised; A2C makes its own.
    pub advantages: &'a [f32],
    /// What the values are fitted to.
    pub returns: &'a [f32],
}

/// The weights of a loss's terms, and the range that it clips to.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct LossSettings {
    /// ε: how far the ratio of probabilities may move from 1, and a value from the old one.
    pub clip_range: f64,
    /// The weight of the value's term.
    pub vf_coef: f64,
    /// The weight of the entropy.
    pub ent_coef: f64,
}

/// Every term of a loss.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct LossTerms {
    /// PPO: the clipped surrogate, negated (Schulman et al. 2017, eq. 7). A2C: the mean of −advantage · log-density.
    pub policy: f64,
    /// PPO: ½ mean of the larger of the squared errors of the value and of the clipped value. A2C: the mean squared error.
    pub value: f64,
    /// The mean entropy.
    pub entropy: f64,
    /// policy + `vf_coef` · value − `ent_coef` · entropy: what is minimised.
    pub total: f64,
    /// The part of the minibatch whose ratio lies outside 1 ± ε.
    pub clip_fraction: f64,
    /// mean(ratio − 1 − ln ratio): an estimate of the divergence from the policy that acted (Schulman 2020).
    pub approx_kl: f64,
}

/// The derivatives of [`LossTerms::total`].
#[derive(Clone, Debug, Default, PartialEq)]
pub struct LossGradients {
    /// For each sample's log-density.
    pub log_probs: Vec<f64>,
    /// For each sample's value.
    pub values: Vec<f64>,
    /// For the entropy of a sample: the same for all.
    pub entropy: f64,
}

/// The loss of proximal policy optimisation with clipped values, in the form that all reference codes share. All slices
/// have one length, which is not 0.
pub fn ppo_loss(inputs: &LossInputs<'_>, settings: &LossSettings) -> (LossTerms, LossGradients) {
    let count = inputs.log_probs.len() as f64;
    let mut terms = LossTerms::default();
    let mut gradients = LossGradients::new(inputs, settings);
    for index in 0..inputs.log_probs.len() {
        let (surrogate, slope) = surrogate(inputs, index, settings.clip_range, &mut terms);
        terms.policy -= surrogate;
        gradients.log_probs.push(-slope / count);
        let (error, slope) = clipped_error(inputs, index, settings.clip_range);
        terms.value += 0.5 * error;
        gradients.values.push(settings.vf_coef * 0.5 * slope / count);
        terms.entropy += inputs.entropies[index];
    }
    (terms.means(count, settings), gradients)
}

/// The loss of advantage actor-critic (Mnih et al. 2016), in the form of the reference: advantages are the returns less
/// the values as the network has them now, and not normalised. All slices have one length, which is not 0.
pub fn a2c_loss(inputs: &LossInputs<'_>, settings: &LossSettings) -> (LossTerms, LossGradients) {
    let count = inputs.log_probs.len() as f64;
    let mut terms = LossTerms::default();
    let mut gradients = LossGradients::new(inputs, settings);
    for (index, &log_prob) in inputs.log_probs.iter().enumerate() {
        // The policy's term takes the advantage as a constant.
        let advantage = f64::from(inputs.returns[index]) - f64::from(inputs.values[index]);
        terms.policy -= advantage * log_prob;
        gradients.log_probs.push(-advantage / count);
        terms.value += advantage * advantage;
        gradients.values.push(settings.vf_coef * -2.0 * advantage / count);
        terms.entropy += inputs.entropies[index];
        terms.approx_kl += divergence(log_prob - inputs.old_log_probs[index]);
    }
    (terms.means(count, settings), gradients)
}

impl LossGradients {
    fn new(inputs: &LossInputs<'_>, settings: &LossSettings) -> Self {
        let count = inputs.log_probs.len();
        let entropy = -settings.ent_coef / count as f64;
        Self { log_probs: Vec::with_capacity(count), values: Vec::with_capacity(count), entropy }
    }
}

impl LossTerms {
    /// From sums over the samples to means, and their total.
    fn means(self, count: f64, settings: &LossSettings) -> Self {
        let (policy, value, entropy) = (self.policy / count, self.value / count, self.entropy / count);
        Self {
            policy,
            value,
            entropy,
            total: policy + value * settings.vf_coef - entropy * settings.ent_coef,
            clip_fraction: self.clip_fraction / count,
            approx_kl: self.approx_kl / count,
        }
    }
}

/// r − 1 − ln r of the ratio r with that logarithm.
fn divergence(log_ratio: f64) -> f64 {
    math::exp_m1(log_ratio) - log_ratio
}

/// min(r A, clamp(r) A) and its derivative for the log-density; counts the ratio r into the statistics.
fn surrogate(inputs: &LossInputs<'_>, index: usize, clip: f64, terms: &mut LossTerms) -> (f64, f64) {
    let log_ratio = inputs.log_probs[index] - inputs.old_log_probs[index];
    let ratio = math::exp(log_ratio);
    let advantage = f64::from(inputs.advantages[index]);
    terms.approx_kl += divergence(log_ratio);
    if (ratio - 1.0).abs() > clip {
        terms.clip_fraction += 1.0;
    }
    let (low, high) = (1.0 - clip, 1.0 + clip);
    let clamped = ratio.clamp(low, high);
    let inside = if (low..=high).contains(&ratio) { 1.0 } else { 0.0 };
    let (plain, clipped) = (ratio * advantage, clamped * advantage);
    let share = share(plain < clipped, plain == clipped);
    let slope = ratio * advantage * (share + (1.0 - share) * inside);
    // A comparison, not `min`, so that a ratio that is not a number is not hidden.
    (if plain < clipped { plain } else { clipped }, slope)
}

/// max((v − R)², (v′ − R)²) with the clipped value v′, and its derivative for the value v.
fn clipped_error(inputs: &LossInputs<'_>, index: usize, clip: f64) -> (f64, f64) {
    let value = f64::from(inputs.values[index]);
    let old = f64::from(inputs.old_values[index]);
    let target = f64::from(inputs.returns[index]);
    let moved = value - old;
    let inside = if (-clip..=clip).contains(&moved) { 1.0 } else { 0.0 };
    let error = value - target;
    let clipped = old + moved.clamp(-clip, clip) - target;
    let (square, clipped_square) = (error * error, clipped * clipped);
    let share = share(square > clipped_square, square == clipped_square);
    let slope = 2.0 * (error * share + clipped * (1.0 - share) * inside);
    (if square > clipped_square { square } else { clipped_square }, slope)
}

/// The part of a gradient that goes to the first of two arguments.
fn share(first_chosen: bool, equal: bool) -> f64 {
    match (first_chosen, equal) {
        (true, _) => 1.0,
        (_, true) => 0.5,
        _ => 0.0,
    }
}

#[cfg(test)]
#[path = "loss_tests.rs"]
mod tests;
