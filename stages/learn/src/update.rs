//! One update of proximal policy optimisation: the loss, the step for a minibatch, and the order of minibatches.

use dril_kinds::{Algorithm, UpdateSettings};
use dril_stage_api::{StageError, StreamRng};
use rand::seq::SliceRandom;
use serde::{Deserialize, Serialize};
use tch::{Device, Kind, Tensor};

use crate::optim::Adam;
use crate::policy::Policy;
use crate::rollout::{Advantages, Rollout};

/// What the loss is computed from, as tensors over a minibatch: all [batch].
#[derive(Debug)]
pub struct Samples {
    /// Log-densities of the actions when they were drawn.
    pub old_log_probs: Tensor,
    /// Values when they were drawn.
    pub old_values: Tensor,
    /// Normalised advantages.
    pub advantages: Tensor,
    /// What the values are fitted to.
    pub returns: Tensor,
}

/// Every term of the loss; scalars.
#[derive(Debug)]
pub struct Losses {
    /// The clipped surrogate, negated (Schulman et al. 2017, eq. 7).
    pub policy: Tensor,
    /// ½ mean of the larger of the squared errors of the value and of the clipped value.
    pub value: Tensor,
    /// The mean entropy.
    pub entropy: Tensor,
    /// policy + value_coef · value − entropy_coef · entropy: what is minimised.
    pub total: Tensor,
    /// The part of the minibatch whose ratio lies outside 1 ± ε.
    pub clip_fraction: Tensor,
    /// mean(ratio − 1 − ln ratio): an estimate of the divergence from the policy that acted (Schulman 2020).
    pub approx_kl: Tensor,
}

/// The loss of proximal policy optimisation with clipped values, in the form that all reference codes share.
pub fn ppo_loss(
    log_probs: &Tensor,
    values: &Tensor,
    entropies: &Tensor,
    samples: &Samples,
    settings: &UpdateSettings,
) -> Losses {
    let clip = settings.clip_range;
    let log_ratio: Tensor = log_probs - &samples.old_log_probs;
    let ratio = log_ratio.exp();
    let plain: Tensor = &ratio * &samples.advantages;
    let clipped: Tensor = ratio.clamp(1.0 - clip, 1.0 + clip) * &samples.advantages;
    let policy = -plain.minimum(&clipped).mean(Kind::Float);
    let clipped_values: Tensor = &samples.old_values + (values - &samples.old_values).clamp(-clip, clip);
    let errors = (values - &samples.returns).square();
    let clipped_errors = (clipped_values - &samples.returns).square();
    let value = errors.maximum(&clipped_errors).mean(Kind::Float) * 0.5;
    let entropy = entropies.mean(Kind::Float);
    let total = &policy + &value * settings.value_coef - &entropy * settings.entropy_coef;
    let (log_ratio, ratio) = (log_ratio.detach(), ratio.detach());
    let clip_fraction = (&ratio - 1.0).abs().gt(clip).to_kind(Kind::Float).mean(Kind::Float);
    let approx_kl = (ratio - 1.0 - log_ratio).mean(Kind::Float);
    Losses { policy, value, entropy, total, clip_fraction, approx_kl }
}

/// The loss of advantage actor-critic (Mnih et al. 2016), in the form of the reference: advantages are the returns less
/// the values as the network has them now, and not normalised.
pub fn a2c_loss(
    log_probs: &Tensor,
    values: &Tensor,
    entropies: &Tensor,
    samples: &Samples,
    settings: &UpdateSettings,
) -> Losses {
    let advantages: Tensor = &samples.returns - values;
    let policy = -(advantages.detach() * log_probs).mean(Kind::Float);
    let value = advantages.square().mean(Kind::Float);
    let entropy = entropies.mean(Kind::Float);
    let total = &policy + &value * settings.value_coef - &entropy * settings.entropy_coef;
    let log_ratio: Tensor = (log_probs - &samples.old_log_probs).detach();
    let approx_kl = (log_ratio.exp() - 1.0 - log_ratio).mean(Kind::Float);
    let clip_fraction = Tensor::zeros([], (Kind::Float, Device::Cpu));
    Losses { policy, value, entropy, total, clip_fraction, approx_kl }
}

/// Means over the minibatches of an update, and what is known of it as a whole.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct UpdateStats {
    /// See [`Losses::policy`].
    pub policy_loss: f64,
    /// See [`Losses::value`].
    pub value_loss: f64,
    /// See [`Losses::entropy`].
    pub entropy: f64,
    /// See [`Losses::clip_fraction`].
    pub clip_fraction: f64,
    /// See [`Losses::approx_kl`].
    pub approx_kl: f64,
    /// 1 − variance of (returns − values) over variance of returns: 1 is a perfect critic, 0 a constant one.
    pub explained_variance: f64,
}

/// An update under way: what it learns from, and the minibatches that are left.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Update {
    batch: Advantages,
    /// Advantages with mean 0 and standard deviation 1 over the whole rollout.
    normalized: Vec<f32>,
    epoch: u64,
    /// The entries of this pass in random order.
    order: Vec<u32>,
    /// The first entry of `order` that is not used yet.
    next: usize,
    sums: UpdateStats,
    count: u64,
}

impl Update {
    /// An update before its first minibatch.
    pub fn new(batch: Advantages) -> Self {
        let normalized = normalize(&batch.advantages);
        Self {
            batch,
            normalized,
            epoch: 0,
            order: Vec::new(),
            next: 0,
            sums: UpdateStats::default(),
            count: 0,
        }
    }

    /// The entries of the next minibatch, in random order without repetition within a pass; what does not fill a
    /// minibatch at the end of a pass is left out. `None` after the last pass.
    pub fn next_minibatch(
        &mut self,
        settings: &UpdateSettings,
        stream: &mut StreamRng,
    ) -> Option<Vec<usize>> {
        let entries = self.normalized.len();
        let (epochs, minibatches) = match settings.algorithm {
            Algorithm::Ppo => (settings.epochs, settings.minibatches),
            Algorithm::A2c => (1, 1),
        };
        let size = entries / minibatches as usize;
        if self.order.is_empty() || self.next + size > entries {
            if self.epoch == epochs {
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

    /// Learns from one minibatch: loss, gradients, one step of Adam with the common norm limited.
    ///
    /// # Errors
    /// The loss is not a number.
    pub fn learn(
        &mut self,
        policy: &mut Policy,
        adam: &mut Adam,
        rollout: &Rollout,
        minibatch: &[usize],
        settings: &UpdateSettings,
        learning_rate: f64,
    ) -> Result<(), StageError> {
        let slots: Vec<usize> = minibatch.iter().map(|&entry| rollout.entry_slot(entry)).collect();
        let seen = rollout.frames.gather_for(&slots, policy.params.precision());
        let answer = policy.forward(&seen);
        let (distribution, values) = (&answer.distribution, &answer.values);
        let samples = self.samples(rollout, minibatch);
        let log_probs = distribution.log_prob(&pick_rows(&rollout.samples, rollout.dims, minibatch));
        let loss = match settings.algorithm {
            Algorithm::Ppo => ppo_loss,
            Algorithm::A2c => a2c_loss,
        };
        let losses = loss(&log_probs, values, &distribution.entropy(), &samples, settings);
        self.add(&losses)?;
        let gradients = answer.gradients(policy, &losses.total, adam.ids());
        adam.step(&mut policy.params, &gradients, learning_rate, Some(settings.max_grad_norm));
        Ok(())
    }

    /// The means over the minibatches so far.
    pub fn stats(&self, rollout: &Rollout) -> UpdateStats {
        let mean = |sum: f64| sum / self.count as f64;
        UpdateStats {
            policy_loss: mean(self.sums.policy_loss),
            value_loss: mean(self.sums.value_loss),
            entropy: mean(self.sums.entropy),
            clip_fraction: mean(self.sums.clip_fraction),
            approx_kl: mean(self.sums.approx_kl),
            explained_variance: explained_variance(&rollout.values, &self.batch.returns),
        }
    }

    fn samples(&self, rollout: &Rollout, minibatch: &[usize]) -> Samples {
        Samples {
            old_log_probs: pick(&rollout.log_probs, minibatch),
            old_values: pick(&rollout.values, minibatch),
            advantages: pick(&self.normalized, minibatch),
            returns: pick(&self.batch.returns, minibatch),
        }
    }

    fn add(&mut self, losses: &Losses) -> Result<(), StageError> {
        let value = |tensor: &Tensor| tensor.double_value(&[]);
        let total = value(&losses.total);
        if !total.is_finite() {
            return Err(StageError::failed(format!(
                "the loss is {total}: the network has diverged; try a lower `learning_rate` or `clip_range`"
            )));
        }
        self.sums.policy_loss += value(&losses.policy);
        self.sums.value_loss += value(&losses.value);
        self.sums.entropy += value(&losses.entropy);
        self.sums.clip_fraction += value(&losses.clip_fraction);
        self.sums.approx_kl += value(&losses.approx_kl);
        self.count += 1;
        Ok(())
    }
}

/// (A − mean) / (std + 1e-5) over the whole rollout, with the sample standard deviation, as the reference codes do.
pub fn normalize(advantages: &[f32]) -> Vec<f32> {
    let (mean, variance) = mean_and_variance(advantages.iter().map(|&a| f64::from(a)));
    let std = (variance * advantages.len() as f64 / (advantages.len() as f64 - 1.0).max(1.0)).sqrt();
    advantages.iter().map(|&a| ((f64::from(a) - mean) / (std + 1e-5)) as f32).collect()
}

/// 1 − Var(returns − values) / Var(returns); not a number where all returns are equal.
pub fn explained_variance(values: &[f32], returns: &[f32]) -> f64 {
    let errors = values.iter().zip(returns).map(|(value, target)| f64::from(*target) - f64::from(*value));
    let (_, unexplained) = mean_and_variance(errors);
    let (_, variance) = mean_and_variance(returns.iter().map(|&target| f64::from(target)));
    if variance == 0.0 { f64::NAN } else { 1.0 - unexplained / variance }
}

fn mean_and_variance(values: impl Iterator<Item = f64> + Clone) -> (f64, f64) {
    let (count, sum) = values.clone().fold((0.0, 0.0), |(count, sum), value| (count + 1.0, sum + value));
    let mean = sum / count;
    (mean, values.map(|value| (value - mean).powi(2)).sum::<f64>() / count)
}

fn pick(values: &[f32], entries: &[usize]) -> Tensor {
    Tensor::from_slice(&entries.iter().map(|&entry| values[entry]).collect::<Vec<f32>>())
}

fn pick_rows(values: &[f32], dims: usize, entries: &[usize]) -> Tensor {
    let rows: Vec<f32> = entries.iter().flat_map(|&entry| &values[entry * dims..][..dims]).copied().collect();
    Tensor::from_slice(&rows).view([entries.len() as i64, dims as i64])
}

#[cfg(test)]
#[path = "update_tests.rs"]
mod tests;
