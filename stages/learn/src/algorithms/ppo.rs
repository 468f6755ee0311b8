//! Proximal policy optimisation (PPO; Schulman et al. 2017) and advantage actor-critic (A2C): advantages, losses with
//! their gradients, and the minibatch loop of an update.
//!
//! Losses and gradients are computed in `f64`, in sample order, with functions whose bits do not depend on the processor.
//! At a corner of a minimum, maximum or clamp, the gradient is PyTorch's: half to each of two equal arguments, all of it
//! at the boundary of a clamp.

use dril_kinds::{Algorithm, UpdateParams};
use dril_stage_api::{StreamRng, math};
use rand::seq::SliceRandom;
use serde::{Deserialize, Serialize};

use crate::nn::{Gradients, Optimizer};
use crate::policy::{Answers, OutputGradients, Parts, Policy, Weights};
use crate::training::rollout::Rollout;

/// Advantages and returns of a rollout, entry by entry.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Advantages {
    /// Generalised advantage estimates.
    pub advantages: Vec<f32>,
    /// Advantages plus values: the targets of the critic.
    pub returns: Vec<f32>,
}

/// Generalised advantage estimation (Schulman et al. 2016, eq. 16), backwards over time:
/// δ = r + γ V(s′) − V(s), A = δ + γ λ A′, with V(s′) the value at a truncation or 0 at a termination, and A′ = 0 at
/// either. `last_values` are the values of the states after the last step, one for each environment.
pub fn gae(rollout: &Rollout, last_values: &[f32], gamma: f64, gae_lambda: f64) -> Advantages {
    let (envs, entries) = (rollout.envs, rollout.len());
    let mut advantages = vec![0.0_f32; entries];
    for (env, &last_value) in last_values.iter().enumerate().take(envs) {
        let mut next = (f64::from(last_value), 0.0);
        for entry in (0..rollout.steps).rev().map(|t| t * envs + env) {
            let (next_value, next_advantage) = match rollout.dones[entry] {
                true => (f64::from(rollout.bootstrap_values[entry]), 0.0),
                false => next,
            };
            let value = f64::from(rollout.values[entry]);
            let delta = f64::from(rollout.rewards[entry]) + gamma * next_value - value;
            let advantage = delta + gamma * gae_lambda * next_advantage;
            advantages[entry] = advantage as f32;
            next = (value, advantage);
        }
    }
    let returns =
        advantages.iter().zip(&rollout.values).map(|(advantage, value)| advantage + value).collect();
    Advantages { advantages, returns }
}

/// Inputs of a loss; one entry for each sample of the minibatch.
#[derive(Clone, Debug, Default)]
pub struct LossInputs {
    /// Log-probabilities of the actions under the current policy.
    pub log_probs: Vec<f64>,
    /// Entropies of the current policy, in nats.
    pub entropies: Vec<f64>,
    /// State values of the current critic.
    pub values: Vec<f32>,
    /// Log-probabilities of the actions under the policy that sampled them.
    pub old_log_probs: Vec<f64>,
    /// State values when the actions were sampled.
    pub old_values: Vec<f32>,
    /// Normalised advantages; not used by A2C.
    pub advantages: Vec<f32>,
    /// Targets of the values.
    pub returns: Vec<f32>,
}

/// Every term of a loss.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct LossTerms {
    /// PPO: the negative clipped surrogate (Schulman et al. 2017, eq. 7). A2C: the mean of −advantage · log-probability.
    pub policy: f64,
    /// PPO: ½ mean of the larger of the squared errors of the value and of the clipped value. A2C: the mean squared error.
    pub value: f64,
    /// The mean entropy.
    pub entropy: f64,
    /// policy + `vf_coef` · value − `ent_coef` · entropy: the minimised loss.
    pub total: f64,
    /// Fraction of the minibatch whose ratio is outside 1 ± ε.
    pub clip_fraction: f64,
    /// mean(ratio − 1 − ln ratio): an estimate of the KL divergence from the policy that acted (Schulman 2020).
    pub approx_kl: f64,
}

/// The derivatives of [`LossTerms::total`].
#[derive(Clone, Debug, Default, PartialEq)]
pub struct LossGradients {
    /// For each sample's log-probability.
    pub log_probs: Vec<f64>,
    /// For each sample's value.
    pub values: Vec<f64>,
    /// For the entropy of a sample: the same for all.
    pub entropy: f64,
}

/// The loss of PPO with clipped values, in the form shared by all reference codes. All lists have the same, non-zero
/// length.
pub fn ppo_loss(inputs: &LossInputs, params: &UpdateParams) -> (LossTerms, LossGradients) {
    let count = inputs.log_probs.len() as f64;
    let mut terms = LossTerms::default();
    let mut gradients = LossGradients::new(inputs, params);
    for index in 0..inputs.log_probs.len() {
        let (surrogate, slope) = surrogate(inputs, index, params.clip_range, &mut terms);
        terms.policy -= surrogate;
        gradients.log_probs.push(-slope / count);
        let (error, slope) = clipped_error(inputs, index, params.clip_range);
        terms.value += 0.5 * error;
        gradients.values.push(params.vf_coef * 0.5 * slope / count);
        terms.entropy += inputs.entropies[index];
    }
    (terms.means(count, params), gradients)
}

/// The loss of A2C (Mnih et al. 2016), in the form of the reference code: advantages are the returns minus the current
/// values, not normalised. All lists have the same, non-zero length.
pub fn a2c_loss(inputs: &LossInputs, params: &UpdateParams) -> (LossTerms, LossGradients) {
    let count = inputs.log_probs.len() as f64;
    let mut terms = LossTerms::default();
    let mut gradients = LossGradients::new(inputs, params);
    for (index, &log_prob) in inputs.log_probs.iter().enumerate() {
        // The policy's term treats the advantage as a constant.
        let advantage = f64::from(inputs.returns[index]) - f64::from(inputs.values[index]);
        terms.policy -= advantage * log_prob;
        gradients.log_probs.push(-advantage / count);
        terms.value += advantage * advantage;
        gradients.values.push(params.vf_coef * -2.0 * advantage / count);
        terms.entropy += inputs.entropies[index];
        terms.approx_kl += divergence(log_prob - inputs.old_log_probs[index]);
    }
    (terms.means(count, params), gradients)
}

impl LossGradients {
    fn new(inputs: &LossInputs, params: &UpdateParams) -> Self {
        let count = inputs.log_probs.len();
        let entropy = -params.ent_coef / count as f64;
        Self { log_probs: Vec::with_capacity(count), values: Vec::with_capacity(count), entropy }
    }
}

impl LossTerms {
    fn add(&mut self, other: &Self) {
        self.policy += other.policy;
        self.value += other.value;
        self.entropy += other.entropy;
        self.total += other.total;
        self.clip_fraction += other.clip_fraction;
        self.approx_kl += other.approx_kl;
    }

    /// Converts sums over the samples to means, and computes the total.
    fn means(self, count: f64, params: &UpdateParams) -> Self {
        let (policy, value, entropy) = (self.policy / count, self.value / count, self.entropy / count);
        Self {
            policy,
            value,
            entropy,
            total: policy + value * params.vf_coef - entropy * params.ent_coef,
            clip_fraction: self.clip_fraction / count,
            approx_kl: self.approx_kl / count,
        }
    }
}

/// r − 1 − ln r, for the ratio r with this logarithm.
fn divergence(log_ratio: f64) -> f64 {
    math::exp_m1(log_ratio) - log_ratio
}

/// min(r A, clamp(r) A) and its derivative with respect to the log-probability; adds the ratio r to the statistics.
fn surrogate(inputs: &LossInputs, index: usize, clip: f64, terms: &mut LossTerms) -> (f64, f64) {
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
    // A comparison, not `min`, so that a NaN ratio is not hidden.
    (if plain < clipped { plain } else { clipped }, slope)
}

/// max((v − R)², (v′ − R)²) with the clipped value v′, and its derivative with respect to the value v.
fn clipped_error(inputs: &LossInputs, index: usize, clip: f64) -> (f64, f64) {
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

/// The fraction of a gradient that goes to the first of two arguments.
fn share(first_chosen: bool, equal: bool) -> f64 {
    match (first_chosen, equal) {
        (true, _) => 1.0,
        (_, true) => 0.5,
        _ => 0.0,
    }
}

/// Why an update from a minibatch failed. The weights were not changed.
#[derive(Clone, Debug, PartialEq)]
pub enum LearnError {
    /// The loss or a gradient is not finite; the text says which.
    Diverged(String),
}

/// Statistics of an update: means over its minibatches, and the explained variance.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct UpdateStats {
    /// See [`LossTerms::policy`].
    pub policy_loss: f64,
    /// See [`LossTerms::value`].
    pub value_loss: f64,
    /// See [`LossTerms::entropy`].
    pub entropy: f64,
    /// See [`LossTerms::clip_fraction`].
    pub clip_fraction: f64,
    /// See [`LossTerms::approx_kl`].
    pub approx_kl: f64,
    /// 1 − variance of (returns − values) over variance of returns: 1 is a perfect critic, 0 a constant one.
    pub explained_variance: f64,
}

/// An update in progress: its data, and the remaining minibatches.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Update {
    batch: Advantages,
    /// Advantages with mean 0 and standard deviation 1 over the whole rollout.
    normalized: Vec<f32>,
    epoch: u64,
    /// The shuffled entries of this epoch.
    order: Vec<u32>,
    /// Position of the next unused entry in `order`.
    next: usize,
    sums: LossTerms,
    count: u64,
}

impl Update {
    /// An update at its start.
    pub fn new(batch: Advantages) -> Self {
        let normalized = normalize(&batch.advantages);
        Self { batch, normalized, epoch: 0, order: Vec::new(), next: 0, sums: LossTerms::default(), count: 0 }
    }

    /// The entries of the next minibatch: shuffled, without repetition within an epoch; a remainder that does not fill a
    /// minibatch is dropped. `None` after the last epoch.
    pub fn next_minibatch(
        &mut self,
        (algorithm, params): (Algorithm, &UpdateParams),
        stream: &mut StreamRng,
    ) -> Option<Vec<usize>> {
        let entries = self.normalized.len();
        let (n_epochs, n_minibatches) = match algorithm {
            Algorithm::Ppo => (params.n_epochs, params.n_minibatches),
            Algorithm::A2c => (1, 1),
        };
        let size = entries / n_minibatches as usize;
        if self.order.is_empty() || self.next + size > entries {
            if self.epoch == n_epochs {
                return None;
            }
            self.epoch += 1;
            self.next = 0;
            self.order = (0..entries as u32).collect();
            self.order.shuffle(stream);
        }
        let minibatch = self.order[self.next..self.next + size].iter().map(|&entry| entry as usize).collect();
        self.next += size;
        Some(minibatch)
    }

    /// Updates the policy from one minibatch: loss, gradients, gradient clipping and one optimizer step.
    ///
    /// # Errors
    /// The loss or a gradient is not finite; the weights stay as they were.
    pub fn learn(
        &mut self,
        (policy, optimizer, gradients): (&mut Policy, &mut Optimizer, &mut Gradients),
        rollout: &Rollout,
        minibatch: &[usize],
        (algorithm, params): (Algorithm, &UpdateParams),
        learning_rate: f64,
    ) -> Result<(), LearnError> {
        let slots: Vec<usize> = minibatch.iter().map(|&entry| rollout.entry_slot(entry)).collect();
        let observations = rollout.frames.gather(&slots);
        let (answers, tape) = policy.forward(&observations, Parts::Both);
        let inputs = self.inputs(policy, &answers, rollout, minibatch);
        let loss = match algorithm {
            Algorithm::Ppo => ppo_loss,
            Algorithm::A2c => a2c_loss,
        };
        let (terms, slopes) = loss(&inputs, params);
        finite("loss", terms.total)?;
        let mut by_output = OutputGradients::new(policy, minibatch.len());
        for (at, &entry) in minibatch.iter().enumerate() {
            let weights = Weights { log_prob: slopes.log_probs[at], entropy: slopes.entropy };
            by_output.add_row(&policy.row(&answers, at), at, rollout.sample(entry), weights);
            by_output.set_value(at, slopes.values[at]);
        }
        gradients.clear();
        policy.backward(&observations, tape, by_output, gradients);
        let norm = optimizer.norm(gradients);
        finite("norm of the gradients", norm)?;
        let limit = Some((norm, params.max_grad_norm));
        stepped(optimizer.step(policy.params_mut(), gradients, learning_rate, limit), learning_rate)?;
        self.sums.add(&terms);
        self.count += 1;
        Ok(())
    }

    /// Inputs of the loss.
    fn inputs(
        &self,
        policy: &Policy,
        answers: &Answers,
        rollout: &Rollout,
        minibatch: &[usize],
    ) -> LossInputs {
        let pick = |values: &[f32]| minibatch.iter().map(|&entry| values[entry]).collect::<Vec<f32>>();
        let rows = minibatch.iter().enumerate().map(|(at, &entry)| {
            let row = policy.row(answers, at);
            (row.log_prob(rollout.sample(entry)), row.entropy())
        });
        let (log_probs, entropies) = rows.unzip();
        LossInputs {
            log_probs,
            entropies,
            values: answers.values.clone(),
            old_log_probs: minibatch.iter().map(|&entry| f64::from(rollout.log_probs[entry])).collect(),
            old_values: pick(&rollout.values),
            advantages: pick(&self.normalized),
            returns: pick(&self.batch.returns),
        }
    }

    /// Statistics over the minibatches so far.
    pub fn stats(&self, rollout: &Rollout) -> UpdateStats {
        let mean = |sum: f64| sum / self.count as f64;
        UpdateStats {
            policy_loss: mean(self.sums.policy),
            value_loss: mean(self.sums.value),
            entropy: mean(self.sums.entropy),
            clip_fraction: mean(self.sums.clip_fraction),
            approx_kl: mean(self.sums.approx_kl),
            explained_variance: explained_variance(&rollout.values, &self.batch.returns),
        }
    }
}

/// Checks that a number is finite.
pub(super) fn finite(what: &str, value: f64) -> Result<(), LearnError> {
    if value.is_finite() { Ok(()) } else { Err(LearnError::Diverged(format!("the {what} is {value}"))) }
}

/// Checks that the optimizer made its step.
pub(super) fn stepped(done: bool, learning_rate: f64) -> Result<(), LearnError> {
    if done {
        return Ok(());
    }
    Err(LearnError::Diverged(format!("a step of size {learning_rate} is not finite in single precision")))
}

/// (A − mean) / (std + 1e-5) over the whole rollout, with the sample standard deviation, as in the reference code.
pub fn normalize(advantages: &[f32]) -> Vec<f32> {
    let (mean, variance) = mean_and_variance(advantages.iter().map(|&a| f64::from(a)));
    let std = (variance * advantages.len() as f64 / (advantages.len() as f64 - 1.0).max(1.0)).sqrt();
    advantages.iter().map(|&a| ((f64::from(a) - mean) / (std + 1e-5)) as f32).collect()
}

/// 1 − Var(returns − values) / Var(returns); NaN if all returns are equal.
pub fn explained_variance(values: &[f32], returns: &[f32]) -> f64 {
    let errors = values.iter().zip(returns).map(|(value, target)| f64::from(*target) - f64::from(*value));
    let (_, unexplained) = mean_and_variance(errors);
    let (_, variance) = mean_and_variance(returns.iter().map(|&target| f64::from(target)));
    if variance == 0.0 { f64::NAN } else { 1.0 - unexplained / variance }
}

fn mean_and_variance(values: impl Iterator<Item = f64> + Clone) -> (f64, f64) {
    let (count, sum) = values.clone().fold((0.0, 0.0), |(count, sum), value| (count + 1.0, sum + value));
    let mean = sum / count;
    (mean, values.map(|value| (value - mean) * (value - mean)).sum::<f64>() / count)
}

#[cfg(test)]
#[path = "ppo_tests.rs"]
mod tests;
