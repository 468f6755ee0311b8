//! The state that every training by reinforcement has: agent, optimizer, environments, rollout, and where it stands
//! between them. It can be saved after every single step and minibatch.

use std::ops::Range;

use dril_envs::{FinishedEpisode, VecEnv};
use dril_kinds::{Algorithm, Precision, UpdateSettings};
use dril_stage_api::{Seed, StageError, StreamRng};
use serde::{Deserialize, Serialize};

use crate::checkpoint::{Arrays, foreign};
use crate::fast::memory;
use crate::log::RecentScores;
use crate::normalize::RewardNormalizer;
use crate::optim::{Adam, AdamSettings};
use crate::policy::Policy;
use crate::rollout::{Rollout, Sampler, SamplerSettings, SamplerState};
use crate::update::{Update, UpdateStats};

/// The settings of a [`Learner`]; see [`dril_kinds::PpoParams`] for each.
#[derive(Clone, Debug, PartialEq)]
pub struct LearnerSettings {
    /// Environments stepped together.
    pub envs: usize,
    /// Steps of each between two updates.
    pub rollout_steps: usize,
    /// Environment steps of the whole training, over which the learning rate falls; only whole updates are made.
    pub total_steps: u64,
    /// The steps of it that this learner makes.
    pub steps: Range<u64>,
    /// Adam's learning rate at the start.
    pub learning_rate: f64,
    /// True: it falls linearly to 0.
    pub anneal_learning_rate: bool,
    /// Added to Adam's denominator.
    pub adam_epsilon: f64,
    /// The settings of an update.
    pub update: UpdateSettings,
    /// How rollouts are gathered.
    pub sampler: SamplerSettings,
    /// True where the environments' rewards are scaled by [`RewardNormalizer::clipped`].
    pub normalize_reward: bool,
    /// The numbers that the network computes with.
    pub precision: Precision,
}

impl LearnerSettings {
    /// How many updates the whole training makes.
    pub fn updates(&self) -> u64 {
        self.updates_in(self.total_steps)
    }

    fn updates_in(&self, steps: u64) -> u64 {
        steps / (self.envs * self.rollout_steps) as u64
    }
}

/// An agent in training.
///
/// The loop over it: [`Learner::step`] until [`Learner::rollout_full`]; [`Learner::begin_update`];
/// [`Learner::next_minibatch`] and [`Learner::learn`] until there is none; [`Learner::end_update`].
pub struct Learner {
    /// The agent.
    pub policy: Policy,
    /// The rollout under way; a training that makes its own rewards changes them when it is full.
    pub rollout: Rollout,
    adam: Adam,
    sampler: Sampler,
    settings: LearnerSettings,
    minibatches: StreamRng,
    updates_done: u64,
    /// Steps of the rollout under way.
    t: usize,
    update: Option<Update>,
    /// None where rewards stay as they are, or are made elsewhere.
    rewards: Option<RewardNormalizer>,
}

/// The part of a [`Learner`]'s checkpoint that is not in arrays.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub struct LearnerState {
    sampler: SamplerState,
    minibatches: StreamRng,
    adam_steps: u64,
    updates_done: u64,
    t: usize,
    update: Option<Update>,
    #[serde(default, skip_serializing_if = "Option::is_none")]
    rewards: Option<RewardNormalizer>,
}

impl Learner {
    /// A training before its first step; streams come from the seed.
    pub fn new(settings: LearnerSettings, mut policy: Policy, envs: VecEnv, seed: Seed) -> Self {
        policy.params.set_precision(settings.precision);
        let architecture = policy.architecture();
        let (count, steps) = (settings.envs, settings.rollout_steps);
        let epsilon = settings.adam_epsilon;
        let adam = match settings.update.algorithm {
            Algorithm::Ppo => AdamSettings { epsilon, ..AdamSettings::default() },
            Algorithm::A2c => AdamSettings::rmsprop(0.99, epsilon),
        };
        Self {
            adam: Adam::new(&policy.params, policy.params.ids().collect(), adam),
            rollout: Rollout::new(architecture.observation, architecture.action_len(), count, steps),
            sampler: Sampler::new(envs, seed, settings.sampler, policy.statistics.take()),
            minibatches: seed.stream("minibatch"),
            rewards: settings
                .normalize_reward
                .then(|| RewardNormalizer::clipped(count, settings.update.gamma)),
            policy,
            updates_done: settings.updates_in(settings.steps.start),
            settings,
            t: 0,
            update: None,
        }
    }

    /// Starts the first episodes; not needed after [`Learner::restore`].
    ///
    /// # Errors
    /// The environments'.
    pub fn start(&mut self) -> Result<(), StageError> {
        self.sampler.start(&mut self.rollout)
    }

    /// True after the last update.
    pub fn finished(&self) -> bool {
        self.updates_done >= self.settings.updates_in(self.settings.steps.end)
    }

    /// Updates done, those before this learner's first step among them.
    pub fn updates_done(&self) -> u64 {
        self.updates_done
    }

    /// Environment steps done, those before this learner's first among them.
    pub fn steps_done(&self) -> u64 {
        self.updates_done * self.rollout.len() as u64 + (self.t * self.rollout.envs) as u64
    }

    /// Environment steps that are done when this learner has finished.
    pub fn last_step(&self) -> u64 {
        self.settings.updates_in(self.settings.steps.end) * self.rollout.len() as u64
    }

    /// The learning rate of this update.
    pub fn learning_rate(&self) -> f64 {
        let left = 1.0 - self.updates_done as f64 / self.settings.updates() as f64;
        self.settings.learning_rate * if self.settings.anneal_learning_rate { left } else { 1.0 }
    }

    /// True where the rollout is complete and an update is due or under way.
    pub fn rollout_full(&self) -> bool {
        self.t == self.rollout.steps
    }

    /// Acts once in every environment; gives the episodes that ended.
    ///
    /// # Errors
    /// The environments'.
    pub fn step(&mut self) -> Result<Vec<FinishedEpisode>, StageError> {
        let finished = self.sampler.step(&self.policy, &mut self.rollout, self.t)?;
        self.t += 1;
        Ok(finished)
    }

    /// True between [`Learner::begin_update`] and [`Learner::end_update`].
    pub fn updating(&self) -> bool {
        self.update.is_some()
    }

    /// Computes advantages from the rollout's rewards and starts the update.
    pub fn begin_update(&mut self) {
        if let Some(normalizer) = &mut self.rewards {
            normalizer.normalize(&mut self.rollout.rewards, &self.rollout.ends);
        }
        let last = self.rollout.observations(self.rollout.steps);
        let last = tch::no_grad(|| self.policy.values(&last).contiguous());
        let UpdateSettings { gamma, gae_lambda, .. } = self.settings.update;
        self.update = Some(Update::new(self.rollout.advantages(memory::values(&last), gamma, gae_lambda)));
    }

    /// The entries of the next minibatch; `None` after the last.
    pub fn next_minibatch(&mut self) -> Option<Vec<usize>> {
        self.update.as_mut()?.next_minibatch(&self.settings.update, &mut self.minibatches)
    }

    /// Learns from one minibatch.
    ///
    /// # Errors
    /// The network has diverged.
    pub fn learn(&mut self, minibatch: &[usize]) -> Result<(), StageError> {
        let (rate, settings) = (self.learning_rate(), &self.settings.update);
        let Some(update) = &mut self.update else { return Ok(()) };
        update.learn(&mut self.policy, &mut self.adam, &self.rollout, minibatch, settings, rate)
    }

    /// Ends the update and makes room for the next rollout.
    pub fn end_update(&mut self) -> UpdateStats {
        let stats = self.update.take().map(|update| update.stats(&self.rollout)).unwrap_or_default();
        self.rollout.begin_next();
        self.updates_done += 1;
        self.t = 0;
        stats
    }

    /// Adds the state to a checkpoint.
    pub fn save(&self, arrays: &mut Arrays) -> LearnerState {
        arrays.put_f32("weights", self.policy.params.values());
        self.adam.save("adam", arrays);
        self.rollout.save(arrays);
        LearnerState {
            sampler: self.sampler.state(),
            minibatches: self.minibatches.clone(),
            adam_steps: self.adam.steps(),
            updates_done: self.updates_done,
            t: self.t,
            update: self.update.clone(),
            rewards: self.rewards.clone(),
        }
    }

    /// Takes up the state of a checkpoint.
    ///
    /// # Errors
    /// The checkpoint is of another training.
    pub fn restore(&mut self, state: LearnerState, arrays: &mut Arrays) -> Result<(), StageError> {
        let weights = arrays.take_f32("weights", self.policy.params.values().len())?;
        self.policy.params.set_values(&weights);
        self.adam.restore("adam", state.adam_steps, arrays)?;
        self.rollout.restore(arrays)?;
        self.sampler.restore(state.sampler)?;
        if state.t > self.rollout.steps {
            return Err(foreign("its rollout is longer"));
        }
        (self.minibatches, self.updates_done, self.t) = (state.minibatches, state.updates_done, state.t);
        (self.update, self.rewards) = (state.update, state.rewards);
        Ok(())
    }

    /// The agent at the end of training, with the statistics that it saw the world through.
    pub fn into_policy(mut self) -> Policy {
        self.policy.statistics = self.sampler.statistics().cloned();
        self.policy
    }
}

/// The log's columns that every training by reinforcement has.
pub const LOG_COLUMNS: [&str; 13] = [
    "update",
    "step",
    "episodes",
    "score_last",
    "score_mean_10",
    "score_mean_100",
    "policy_loss",
    "value_loss",
    "entropy",
    "explained_variance",
    "clip_fraction",
    "approx_kl",
    "learning_rate",
];

/// The row of an update, in the order of [`LOG_COLUMNS`]; to be made before [`Learner::end_update`] counts it.
pub fn log_row(update: u64, step: u64, rate: f64, scores: &RecentScores, stats: &UpdateStats) -> [f64; 13] {
    [
        update as f64,
        step as f64,
        scores.episodes as f64,
        scores.last(),
        scores.mean(10),
        scores.mean(100),
        stats.policy_loss,
        stats.value_loss,
        stats.entropy,
        stats.explained_variance,
        stats.clip_fraction,
        stats.approx_kl,
        rate,
    ]
}
