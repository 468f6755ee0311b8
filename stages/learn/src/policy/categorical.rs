//! Categorical distributions: closed forms for one row of logits, in double precision. A discrete action is a number from
//! 0, stored as `f32` like other actions.
//!
//! With p = softmax(logits) and H = −Σ p ln p: d ln p(c) / d logit(k) = \[k = c\] − p(k) and
//! dH / d logit(k) = −p(k) (ln p(k) + H).

use dril_stage_api::{draw, math};
use rand::Rng;

use super::weights::{Weights, add};

/// ln Σ exp(logit): subtracted from the logits, it gives the log-probabilities.
fn log_sum(logits: &[f32]) -> f64 {
    let highest = f64::from(logits.iter().copied().fold(f32::NEG_INFINITY, f32::max));
    let sum: f64 = logits.iter().map(|&logit| math::exp(f64::from(logit) - highest)).sum();
    highest + math::ln(sum)
}

/// The log-probabilities.
fn logs(logits: &[f32]) -> impl Iterator<Item = f64> + '_ {
    let log_sum = log_sum(logits);
    logits.iter().map(move |&logit| f64::from(logit) - log_sum)
}

/// The log-probability of an action, which must be one of the logits'.
pub(super) fn log_prob(logits: &[f32], choice: f32) -> f64 {
    f64::from(logits[choice as usize]) - log_sum(logits)
}

/// −Σ p ln p.
pub(super) fn entropy(logits: &[f32]) -> f64 {
    -logs(logits).map(|log| math::exp(log) * log).sum::<f64>()
}

/// The most likely action; the first of several.
pub(super) fn likeliest(logits: &[f32]) -> f32 {
    let mut best = 0;
    for (choice, logit) in logits.iter().enumerate() {
        if *logit > logits[best] {
            best = choice;
        }
    }
    best as f32
}

/// Samples an action. NaN logits give the last one; the next update reports them.
pub(super) fn sample<R: Rng + ?Sized>(logits: &[f32], rng: &mut R) -> f32 {
    draw::categorical(rng, logs(logits).map(math::exp)) as f32
}

/// Adds the gradients with respect to the logits.
pub(super) fn add_gradient(logits: &[f32], choice: f32, weights: Weights, into: &mut [f32]) {
    let entropy = if weights.entropy == 0.0 { 0.0 } else { entropy(logits) };
    for (index, (log, into)) in logs(logits).zip(into).enumerate() {
        let probability = math::exp(log);
        let chosen = if index == choice as usize { 1.0 } else { 0.0 };
        let by_log_prob = weights.log_prob * (chosen - probability);
        add(into, by_log_prob - weights.entropy * probability * (log + entropy));
    }
}
