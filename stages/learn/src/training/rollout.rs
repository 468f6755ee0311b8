//! Rollouts: observations, actions and rewards between two updates, and the sampler that collects them.

use dril_envs::{FinishedEpisode, ObservationSpace, Outcome, VecEnv};
use dril_stage_api::{Seed, StageError, StreamRng};
use rand::Rng;
use serde::{Deserialize, Serialize};

use super::checkpoint::{Arrays, foreign};
use super::normalize::ObservationStatistics;
use crate::data::frames::FrameStore;
use crate::nn::Batch;
use crate::play::act::{Acted, act};
use crate::policy::{Policy, to_environment};

/// The steps of several environments between two updates. Lists are ordered by time, then environment: entry
/// `t · envs + env`.
#[derive(Clone, Debug, PartialEq)]
pub struct Rollout {
    /// Number of environments.
    pub envs: usize,
    /// Steps per environment.
    pub steps: usize,
    /// Action dimensions.
    pub dims: usize,
    /// Frames; see [`Rollout::slot`] for the slot of an entry.
    pub frames: FrameStore,
    /// Samples in the distribution's own range, [entries · dims].
    pub samples: Vec<f32>,
    /// Actions in the environment's range, not clipped, [entries · dims].
    pub actions: Vec<f32>,
    /// Log-probabilities of the samples under the policy that drew them.
    pub log_probs: Vec<f32>,
    /// Values of the states.
    pub values: Vec<f32>,
    /// Rewards; an algorithm with its own rewards replaces them before advantages are computed.
    pub rewards: Vec<f32>,
    /// True if the step ended an episode.
    pub dones: Vec<bool>,
    /// For steps truncated by the time limit, the value of the following state; otherwise 0.
    pub bootstrap_values: Vec<f32>,
}

impl Rollout {
    /// An empty rollout for `steps` steps of `envs` environments.
    pub fn new(observation: ObservationSpace, dims: usize, envs: usize, steps: usize) -> Self {
        let entries = envs * steps;
        // Each environment's slots: the history of the first stack, then the frame before each action, then the last.
        let slots = envs * (observation.stack() + steps);
        Self {
            envs,
            steps,
            dims,
            frames: FrameStore::with_slots(observation, slots),
            samples: vec![0.0; entries * dims],
            actions: vec![0.0; entries * dims],
            log_probs: vec![0.0; entries],
            values: vec![0.0; entries],
            rewards: vec![0.0; entries],
            dones: vec![false; entries],
            bootstrap_values: vec![0.0; entries],
        }
    }

    /// Number of entries.
    pub fn len(&self) -> usize {
        self.envs * self.steps
    }

    /// True if there is no entry.
    pub fn is_empty(&self) -> bool {
        self.len() == 0
    }

    /// The frame slot of the state before step `t`; `t = steps` is the state after the last one.
    pub fn slot(&self, t: usize, env: usize) -> usize {
        let stack = self.frames.observation().stack();
        env * (stack + self.steps) + stack - 1 + t
    }

    /// The frame slot of an entry.
    pub fn entry_slot(&self, entry: usize) -> usize {
        self.slot(entry / self.envs, entry % self.envs)
    }

    /// The sample that was drawn at an entry.
    pub fn sample(&self, entry: usize) -> &[f32] {
        &self.samples[entry * self.dims..][..self.dims]
    }

    /// The observations before step `t`, one per environment.
    pub fn observations(&self, t: usize) -> Batch {
        let slots: Vec<usize> = (0..self.envs).map(|env| self.slot(t, env)).collect();
        self.frames.gather(&slots)
    }

    /// Starts a new rollout at the state after the last step, with its history.
    pub fn begin_next(&mut self) {
        let stack = self.frames.observation().stack();
        for env in 0..self.envs {
            self.frames.carry(self.slot(self.steps, env), stack, self.slot(0, env) + 1 - stack);
        }
    }

    /// Saves the content to a checkpoint.
    pub fn save(&self, arrays: &mut Arrays) {
        self.frames.save("rollout.frames", arrays);
        for (name, values) in self.lists() {
            arrays.put_f32(&format!("rollout.{name}"), values);
        }
        arrays.put("rollout.dones", self.dones.iter().map(|&end| u8::from(end)).collect::<Vec<u8>>());
    }

    /// Restores the content from a checkpoint.
    ///
    /// # Errors
    /// The checkpoint is from a rollout of another size.
    pub fn restore(&mut self, arrays: &mut Arrays) -> Result<(), StageError> {
        self.frames.restore("rollout.frames", arrays)?;
        for (name, values) in [
            ("samples", &mut self.samples),
            ("actions", &mut self.actions),
            ("log_probs", &mut self.log_probs),
            ("values", &mut self.values),
            ("rewards", &mut self.rewards),
            ("bootstrap_values", &mut self.bootstrap_values),
        ] {
            *values = arrays.take_f32(&format!("rollout.{name}"), values.len())?;
        }
        let dones = arrays.take("rollout.dones")?;
        if dones.len() != self.dones.len() {
            return Err(foreign("the rollout has another size"));
        }
        self.dones = dones.into_iter().map(|done| done != 0).collect();
        Ok(())
    }

    fn lists(&self) -> [(&'static str, &[f32]); 6] {
        [
            ("samples", &self.samples),
            ("actions", &self.actions),
            ("log_probs", &self.log_probs),
            ("values", &self.values),
            ("rewards", &self.rewards),
            ("bootstrap_values", &self.bootstrap_values),
        ]
    }
}

/// Collects rollouts: the environments, and the random streams for actions and episode seeds.
pub struct Sampler {
    envs: VecEnv,
    actions: StreamRng,
    /// The seeds of each environment's episodes.
    tracks: Vec<StreamRng>,
    settings: SamplerSettings,
    /// Observation statistics, updated with every step.
    statistics: Option<ObservationStatistics>,
}

/// How a [`Sampler`] acts, and how it treats truncation.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SamplerSettings {
    /// Probability per step, drawn once for all environments, of using the mean action.
    pub mean_action_probability: f64,
    /// True to bootstrap the value at truncation; false to treat truncation as termination.
    pub bootstrap_time_limits: bool,
    /// True to normalise vector observations by running statistics.
    pub normalize_observations: bool,
}

/// The state of a [`Sampler`] for a checkpoint.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct SamplerState {
    envs: dril_envs::VecEnvSnapshot,
    actions: StreamRng,
    tracks: Vec<StreamRng>,
    #[serde(default, skip_serializing_if = "Option::is_none")]
    statistics: Option<ObservationStatistics>,
}

impl Sampler {
    /// A sampler over `envs`, with its own streams from the seed. If observations are normalised, the statistics continue
    /// from `statistics`, if given.
    pub fn new(
        envs: VecEnv,
        seed: Seed,
        settings: SamplerSettings,
        statistics: Option<ObservationStatistics>,
    ) -> Self {
        let tracks = (0..envs.len()).map(|env| seed.stream(&format!("tracks/{env}"))).collect();
        let statistics = match envs.spaces().0 {
            ObservationSpace::Vector { len } if settings.normalize_observations => {
                Some(statistics.unwrap_or_else(|| ObservationStatistics::new(len)))
            }
            _ => None,
        };
        Self { envs, actions: seed.stream("action"), tracks, settings, statistics }
    }

    /// The current observation statistics.
    pub fn statistics(&self) -> Option<&ObservationStatistics> {
        self.statistics.as_ref()
    }

    /// Adds the current observations to the statistics, if there are any.
    fn observe(&mut self) {
        let Self { envs, statistics, .. } = self;
        if let Some(statistics) = statistics {
            statistics.observe((0..envs.len()).map(|env| envs.frame(env)));
        }
    }

    /// Starts the first episodes.
    ///
    /// # Errors
    /// An environment cannot be reset.
    pub fn start(&mut self, rollout: &mut Rollout) -> Result<(), StageError> {
        let tracks = &mut self.tracks;
        self.envs.reset_all(|env| tracks[env].next_u64()).map_err(StageError::failed)?;
        self.observe();
        for env in 0..self.envs.len() {
            let slot = rollout.slot(0, env);
            rollout.frames.set_scaled(slot, self.envs.frame(env), true, self.statistics.as_ref());
        }
        Ok(())
    }

    /// Takes one step in every environment and records it as step `t`; returns the episodes that ended, in the order of the
    /// environments.
    ///
    /// # Errors
    /// An environment fails.
    pub fn step(
        &mut self,
        policy: &Policy,
        rollout: &mut Rollout,
        t: usize,
    ) -> Result<Vec<FinishedEpisode>, StageError> {
        let acted =
            act(policy, &rollout.observations(t), self.settings.mean_action_probability, &mut self.actions);
        record_acting(rollout, t, &acted);
        let family = policy.architecture().family;
        let clipped: Vec<f32> = acted.actions.iter().map(|action| to_environment(family, *action)).collect();
        let tracks = &mut self.tracks;
        let steps = self.envs.step(&clipped, |env| tracks[env].next_u64()).map_err(StageError::failed)?;
        let steps = steps.to_vec();
        self.observe();
        let mut finished = Vec::new();
        for (env, step) in steps.into_iter().enumerate() {
            let (entry, slot) = (t * rollout.envs + env, rollout.slot(t + 1, env));
            rollout.rewards[entry] = step.reward as f32;
            rollout.dones[entry] = step.outcome.ended();
            rollout.bootstrap_values[entry] = 0.0;
            if let Some(episode) = step.finished {
                if step.outcome == Outcome::TimeLimit && self.settings.bootstrap_time_limits {
                    let frame = episode.last_frame.as_frame();
                    rollout.frames.set_scaled(slot, frame, false, self.statistics.as_ref());
                    let observation = rollout.frames.gather(&[slot]);
                    rollout.bootstrap_values[entry] = policy.values(&observation)[0];
                }
                finished.push(episode);
            }
            let (frame, first) = (self.envs.frame(env), step.outcome.ended());
            rollout.frames.set_scaled(slot, frame, first, self.statistics.as_ref());
        }
        Ok(finished)
    }

    /// The state for a checkpoint.
    pub fn state(&self) -> SamplerState {
        SamplerState {
            envs: self.envs.snapshot(),
            actions: self.actions.clone(),
            tracks: self.tracks.clone(),
            statistics: self.statistics.clone(),
        }
    }

    /// Restores a state.
    ///
    /// # Errors
    /// It is from another number or type of environments.
    pub fn restore(&mut self, state: SamplerState) -> Result<(), StageError> {
        self.envs.restore(&state.envs).map_err(|error| foreign(&error.to_string()))?;
        self.actions = state.actions;
        self.tracks = state.tracks;
        self.statistics = state.statistics;
        Ok(())
    }
}

fn record_acting(rollout: &mut Rollout, t: usize, acted: &Acted) {
    let (first, count, dims) = (t * rollout.envs, rollout.envs, rollout.dims);
    rollout.samples[first * dims..][..count * dims].copy_from_slice(&acted.samples);
    rollout.actions[first * dims..][..count * dims].copy_from_slice(&acted.actions);
    rollout.log_probs[first..][..count].copy_from_slice(&acted.log_probs);
    rollout.values[first..][..count].copy_from_slice(&acted.values);
}

#[cfg(test)]
#[path = "rollout_tests.rs"]
mod tests;
