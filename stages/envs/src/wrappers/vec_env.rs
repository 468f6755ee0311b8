//! Vectorised environments, optionally stepped by several threads; results do not depend on their number.

use rayon::prelude::*;
use serde::{Deserialize, Serialize};

use crate::{
    ActionSpace, Env, EnvConfig, EnvError, EnvSnapshot, Frame, ObservationSpace, Outcome, OwnedFrame,
};

/// Several environments with the same settings. An environment whose episode ends is reset immediately.
pub struct VecEnv {
    slots: Vec<Slot>,
    steps: Vec<VecStep>,
    pool: Option<rayon::ThreadPool>,
    spaces: (ObservationSpace, ActionSpace),
}

/// Result of a step in one environment.
#[derive(Clone, Debug, PartialEq)]
pub struct VecStep {
    /// Reward of the environment.
    pub reward: f64,
    /// State of the episode that the action belonged to.
    pub outcome: Outcome,
    /// That episode, if the step ended it; [`VecEnv::frame`] then already shows the next one.
    pub finished: Option<FinishedEpisode>,
}

/// A finished episode.
#[derive(Clone, Debug, PartialEq)]
pub struct FinishedEpisode {
    /// Its seed.
    pub seed: u64,
    /// Sum of its rewards.
    pub score: f64,
    /// Number of steps.
    pub length: usize,
    /// The observation after its last action, for bootstrapping the value at truncation.
    pub last_frame: OwnedFrame,
}

/// Everything needed to continue a [`VecEnv`] bit-identically.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct VecEnvSnapshot {
    /// One per environment.
    pub envs: Vec<VecEnvSlotSnapshot>,
}

/// One environment of a [`VecEnvSnapshot`].
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct VecEnvSlotSnapshot {
    /// Seed and actions of the running episode.
    pub env: EnvSnapshot,
    /// Sum of rewards so far, as the bits of an `f64` (exact in every format).
    pub score_bits: u64,
    /// Steps so far.
    pub length: usize,
    /// Step at which the running episode is truncated; see [`VecEnv::stagger`].
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub cut_after: Option<usize>,
}

struct Slot {
    env: Box<dyn Env>,
    seed: u64,
    score: f64,
    length: usize,
    /// Only in the first episode.
    cut_after: Option<usize>,
}

impl VecEnv {
    /// `count` environments, stepped by `threads` threads.
    ///
    /// # Errors
    /// Invalid settings, `count` or `threads` is 0, or the threads cannot be started.
    pub fn new(config: &EnvConfig, count: usize, threads: usize) -> Result<Self, EnvError> {
        for (field, value) in [("envs", count), ("threads", threads)] {
            if value == 0 {
                return Err(EnvError::Config {
                    field: field.into(),
                    message: "0, expected at least 1".into(),
                });
            }
        }
        let envs = config.build_several(count, threads)?;
        let spaces = (envs[0].observation_space(), envs[0].action_space());
        Self::of(envs, spaces, threads)
    }

    /// The given environments, all with these spaces, stepped by `threads` threads.
    ///
    /// # Errors
    /// The threads cannot be started.
    pub fn of(
        envs: Vec<Box<dyn Env>>,
        spaces: (ObservationSpace, ActionSpace),
        threads: usize,
    ) -> Result<Self, EnvError> {
        let slots: Vec<Slot> = envs
            .into_iter()
            .map(|env| Slot { env, seed: 0, score: 0.0, length: 0, cut_after: None })
            .collect();
        let steps = vec![VecStep { reward: 0.0, outcome: Outcome::Running, finished: None }; slots.len()];
        let threads = threads.min(slots.len());
        let pool = (threads > 1).then(|| rayon::ThreadPoolBuilder::new().num_threads(threads).build());
        let pool =
            pool.transpose().map_err(|error| EnvError::Threads { threads, message: error.to_string() })?;
        Ok(Self { slots, steps, pool, spaces })
    }

    /// Number of environments.
    pub fn len(&self) -> usize {
        self.slots.len()
    }

    /// Always false: there is at least one environment.
    pub fn is_empty(&self) -> bool {
        self.slots.is_empty()
    }

    /// Observation and action space of each environment.
    pub fn spaces(&self) -> &(ObservationSpace, ActionSpace) {
        &self.spaces
    }

    /// Staggers the first episodes: that of environment i of n, counted from 1, is truncated after i/n of `steps` steps (at
    /// least 1). Otherwise, episodes of equal length start and end together forever. Call it before
    /// [`VecEnv::reset_all`].
    pub fn stagger(&mut self, steps: usize) {
        let count = self.slots.len();
        for (index, slot) in self.slots.iter_mut().enumerate() {
            // In 128 bits, since `steps` may be any number.
            let share = steps as u128 * (index as u128 + 1) / count as u128;
            slot.cut_after = Some((share as usize).max(1));
        }
    }

    /// Starts a new episode in every environment; `seeds` is called in the order of the environments.
    ///
    /// # Errors
    /// As [`Env::reset`].
    pub fn reset_all(&mut self, mut seeds: impl FnMut(usize) -> u64) -> Result<(), EnvError> {
        for (index, slot) in self.slots.iter_mut().enumerate() {
            slot.seed = seeds(index);
        }
        self.for_each(|slot, _| slot.start())
    }

    /// Takes one step in every environment. `actions`: `count * dims`, row-major. An environment whose episode ends is reset
    /// immediately with `next_seed(index)`, called in the order of the environments.
    ///
    /// # Errors
    /// As [`Env::step`]. After an error, reset or restore before the next step.
    pub fn step(
        &mut self,
        actions: &[f32],
        mut next_seed: impl FnMut(usize) -> u64,
    ) -> Result<&[VecStep], EnvError> {
        let dims = self.spaces.1.action_len();
        let expected = dims * self.slots.len();
        if actions.len() != expected {
            return Err(EnvError::ActionLength { seen: actions.len(), expected });
        }
        // Environments in other processes run in parallel, whatever the number of threads here.
        for (index, slot) in self.slots.iter_mut().enumerate() {
            let begun = slot.env.begin(&actions[index * dims..(index + 1) * dims]);
            begun.map_err(|source| EnvError::Worker { index, source: Box::new(source) })?;
        }
        self.for_each(|slot, (index, step)| slot.step(&actions[index * dims..(index + 1) * dims], step))?;
        let ended = |step: &VecStep| step.outcome.ended();
        if self.steps.iter().any(ended) {
            for (index, slot) in self.slots.iter_mut().enumerate() {
                if ended(&self.steps[index]) {
                    slot.seed = next_seed(index);
                }
            }
            self.for_each(|slot, (_, step)| if step.outcome.ended() { slot.start() } else { Ok(()) })?;
        }
        Ok(&self.steps)
    }

    /// The newest observation of one environment.
    pub fn frame(&self, env: usize) -> Frame<'_> {
        self.slots[env].env.frame()
    }

    /// Seed of the running episode of one environment.
    pub fn seed(&self, env: usize) -> u64 {
        self.slots[env].seed
    }

    /// Snapshot for [`VecEnv::restore`].
    pub fn snapshot(&self) -> VecEnvSnapshot {
        let slot = |slot: &Slot| VecEnvSlotSnapshot {
            env: slot.env.snapshot(),
            score_bits: slot.score.to_bits(),
            length: slot.length,
            cut_after: slot.cut_after,
        };
        VecEnvSnapshot { envs: self.slots.iter().map(slot).collect() }
    }

    /// Restores all episodes to the point at which the snapshot was taken.
    ///
    /// # Errors
    /// The snapshot has another number of environments, or is not from environments with these settings.
    pub fn restore(&mut self, snapshot: &VecEnvSnapshot) -> Result<(), EnvError> {
        let (seen, expected) = (snapshot.envs.len(), self.slots.len());
        if seen != expected {
            return Err(EnvError::Snapshot(format!("it has {seen} environments, expected {expected}")));
        }
        self.for_each(|slot, (index, _)| slot.restore(&snapshot.envs[index]))
    }

    /// Runs `work` for every environment; returns the error with the lowest index, independent of thread timing.
    fn for_each(
        &mut self,
        work: impl Fn(&mut Slot, (usize, &mut VecStep)) -> Result<(), EnvError> + Sync,
    ) -> Result<(), EnvError> {
        let run = |(index, (slot, step)): (usize, (&mut Slot, &mut VecStep))| {
            let result = work(slot, (index, step));
            result.map_err(|source| EnvError::Worker { index, source: Box::new(source) })
        };
        let (slots, steps) = (&mut self.slots, &mut self.steps);
        match &self.pool {
            None => slots.iter_mut().zip(steps).enumerate().try_for_each(run),
            Some(pool) => pool.install(|| {
                let all = slots.par_iter_mut().zip(steps.par_iter_mut()).enumerate();
                all.map(|item| (item.0, run(item)))
                    .filter_map(|(index, result)| result.err().map(|error| (index, error)))
                    .min_by_key(|(index, _)| *index)
                    .map_or(Ok(()), |(_, error)| Err(error))
            }),
        }
    }
}

impl Slot {
    fn start(&mut self) -> Result<(), EnvError> {
        self.env.reset(self.seed)?;
        self.score = 0.0;
        self.length = 0;
        Ok(())
    }

    fn step(&mut self, action: &[f32], into: &mut VecStep) -> Result<(), EnvError> {
        let step = self.env.step(action)?;
        self.score += step.reward;
        self.length += 1;
        into.reward = step.reward;
        let cut = step.outcome == Outcome::Running && self.cut_after == Some(self.length);
        into.outcome = if cut { Outcome::TimeLimit } else { step.outcome };
        into.finished = into.outcome.ended().then(|| FinishedEpisode {
            seed: self.seed,
            score: self.score,
            length: self.length,
            last_frame: self.env.frame().to_owned(),
        });
        if into.outcome.ended() {
            self.cut_after = None;
        }
        Ok(())
    }

    fn restore(&mut self, snapshot: &VecEnvSlotSnapshot) -> Result<(), EnvError> {
        self.env.restore(&snapshot.env)?;
        self.seed = snapshot.env.seed.unwrap_or(0);
        self.score = f64::from_bits(snapshot.score_bits);
        self.length = snapshot.length;
        self.cut_after = snapshot.cut_after;
        Ok(())
    }
}

#[cfg(test)]
#[path = "vec_env_tests.rs"]
mod tests;
