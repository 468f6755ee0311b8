//! Acting: from a batch of observations to actions, and playing a list of episodes, several in parallel.

use std::collections::BTreeSet;

use dril_envs::{Env, EnvConfig, EnvError, Frame, Outcome};
use dril_stage_api::{Seed, StageError, StreamRng};
use rand::RngExt;

use crate::data::frames::FrameStore;
use crate::nn::Batch;
use crate::policy::{Parts, Policy, to_action};

pub use dril_kinds::Mode;

/// Actions for a batch of observations; row-major, one row per observation.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Acted {
    /// Samples in the distribution's own range, [batch · actions].
    pub samples: Vec<f32>,
    /// Their log-probabilities, [batch].
    pub log_probs: Vec<f32>,
    /// State values, [batch].
    pub values: Vec<f32>,
    /// Actions in the environment's range, not clipped, [batch · actions].
    pub actions: Vec<f32>,
}

/// Samples an action for each observation or, with probability `mean_action_probability` (one draw for the whole batch,
/// from the same stream), uses the mean for all of them, as DRIL's reference code does with 0.1.
pub fn act(
    policy: &Policy,
    observations: &Batch,
    mean_action_probability: f64,
    stream: &mut StreamRng,
) -> Acted {
    let answers = policy.infer(observations, Parts::Both);
    let dims = policy.architecture().action_len();
    let mean = draws_mean(mean_action_probability, stream);
    let mut samples = vec![0.0; observations.rows() * dims];
    let log_probs = samples.chunks_exact_mut(dims).enumerate().map(|(row, sample)| {
        let row = policy.row(&answers, row);
        if mean {
            row.mean(sample)
        } else {
            row.sample(stream, sample)
        }
        row.log_prob(sample) as f32
    });
    let log_probs = log_probs.collect();
    let family = policy.architecture().family;
    let actions = samples.iter().map(|&sample| to_action(family, sample)).collect();
    Acted { log_probs, values: answers.values, actions, samples }
}

/// Draws nothing if the probability is 0.
fn draws_mean(probability: f64, stream: &mut StreamRng) -> bool {
    probability > 0.0 && stream.random::<f64>() < probability
}

/// How a list of episodes is played.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Play {
    /// Mean actions or samples.
    pub mode: Mode,
    /// In stochastic mode, the probability per step of using the mean action.
    pub mean_action_probability: f64,
    /// Episode `i` uses the environment seed `first_seed + i`.
    pub first_seed: u64,
    /// Number of episodes.
    pub episodes: usize,
    /// True to record observations and actions.
    pub record: bool,
}

/// An episode, as far as it has been played.
#[derive(Clone, Debug, PartialEq)]
pub struct PlayedEpisode {
    /// Its position in the list.
    pub index: usize,
    /// The seed of its environment.
    pub seed: u64,
    /// The sum of its rewards.
    pub score: f64,
    /// Its steps.
    pub steps: u64,
    /// How it ended.
    pub outcome: Outcome,
    /// If recorded: the frame before each action; empty for vector observations.
    pub frames: Vec<u8>,
    /// If recorded: the vector before each action; empty for image observations.
    pub vectors: Vec<f32>,
    /// If recorded: the actions as the policy chose them, not clipped.
    pub actions: Vec<f32>,
}

/// Number of episodes played in parallel. Episode `i` is always played in row `i mod WIDTH` of a full batch, and a row's
/// result does not depend on the other rows. So an episode's score depends on the policy, its seed and its own stream, and
/// not on the number or length of other episodes.
pub const WIDTH: usize = 8;

/// Plays episodes of a list, [`WIDTH`] at a time.
pub struct Player<'a> {
    policy: &'a Policy,
    play: Play,
    seed: Seed,
    rows: Vec<Row>,
    frames: FrameStore,
    depth: usize,
    /// Episodes to skip.
    skipped: BTreeSet<usize>,
}

/// One row of the batch.
struct Row {
    env: Box<dyn Env>,
    /// The running episode; none if the list is exhausted.
    episode: Option<(PlayedEpisode, StreamRng)>,
    /// The next episode of this row.
    next: usize,
}

impl<'a> Player<'a> {
    /// A player for `policy` in environments of `env`. The actions of episode `i` are drawn from the stream `action` of the
    /// seed's child `episode/i`.
    ///
    /// # Errors
    /// The environment cannot be built, or its spaces differ from the policy's.
    pub fn new(policy: &'a Policy, env: &EnvConfig, play: Play, seed: Seed) -> Result<Self, StageError> {
        crate::spaces::check(policy, env)?;
        let envs = env.build_several(WIDTH, 1).map_err(StageError::failed)?;
        Ok(Self::with(policy, envs, play, seed))
    }

    /// As [`Player::new`], with [`WIDTH`] given environments.
    fn with(policy: &'a Policy, envs: Vec<Box<dyn Env>>, play: Play, seed: Seed) -> Self {
        let rows = envs.into_iter().enumerate().map(|(row, env)| Row { env, episode: None, next: row });
        let observation = policy.architecture().observation;
        let depth = observation.stack();
        let frames = FrameStore::with_slots(observation, WIDTH * depth);
        Self { policy, play, seed, rows: rows.collect(), frames, depth, skipped: BTreeSet::new() }
    }

    /// Skips these episodes, which were played before; the others have the same result. Call it before the first step.
    pub fn skip(&mut self, episodes: impl IntoIterator<Item = usize>) {
        self.skipped.extend(episodes);
    }

    /// Takes one step in every running episode; returns those that ended, in the order of the rows, or `None` when the list
    /// is exhausted.
    ///
    /// # Errors
    /// An environment fails.
    pub fn step(&mut self) -> Result<Option<Vec<PlayedEpisode>>, StageError> {
        self.step_rows().map_err(StageError::failed)
    }

    fn step_rows(&mut self) -> Result<Option<Vec<PlayedEpisode>>, EnvError> {
        for row in 0..WIDTH {
            self.start_next(row)?;
        }
        if self.rows.iter().all(|row| row.episode.is_none()) {
            return Ok(None);
        }
        let actions = self.actions();
        let mut ended = Vec::new();
        let dims = self.policy.architecture().action_len();
        for (row, action) in self.rows.iter_mut().zip(actions.chunks_exact(dims)) {
            if row.episode.is_some() {
                row.env.begin(action)?;
            }
        }
        for (row, action) in actions.chunks_exact(dims).enumerate() {
            ended.extend(self.act(row, action)?);
        }
        Ok(Some(ended))
    }

    /// The running episode of a row.
    pub fn playing(&self, row: usize) -> Option<&PlayedEpisode> {
        self.rows.get(row)?.episode.as_ref().map(|(played, _)| played)
    }

    /// The environment of a row below [`WIDTH`], for rendering.
    pub fn env(&mut self, row: usize) -> &mut dyn Env {
        self.rows[row].env.as_mut()
    }

    /// Starts the row's next episode, if none is running and there is one.
    fn start_next(&mut self, index: usize) -> Result<(), EnvError> {
        let row = &mut self.rows[index];
        if row.episode.is_some() {
            return Ok(());
        }
        while self.skipped.contains(&row.next) {
            row.next += WIDTH;
        }
        if row.next >= self.play.episodes {
            return Ok(());
        }
        let episode = row.next;
        row.next += WIDTH;
        let seed = self.play.first_seed.wrapping_add(episode as u64);
        row.env.reset(seed)?;
        let played = PlayedEpisode {
            index: episode,
            seed,
            score: 0.0,
            steps: 0,
            outcome: Outcome::Running,
            frames: Vec::new(),
            vectors: Vec::new(),
            actions: Vec::new(),
        };
        row.episode = Some((played, self.seed.child(&format!("episode/{episode}")).stream("action")));
        let newest = index * self.depth + self.depth - 1;
        self.frames.set_scaled(newest, row.env.frame(), true, self.policy.statistics.as_ref());
        Ok(())
    }

    /// Actions for every row, not clipped; those of finished rows are not used.
    fn actions(&mut self) -> Vec<f32> {
        let architecture = self.policy.architecture();
        let slots: Vec<usize> = (0..WIDTH).map(|row| row * self.depth + self.depth - 1).collect();
        let observations = self.frames.gather(&slots);
        let answers = self.policy.infer(&observations, Parts::Actor);
        let mut samples = vec![0.0; WIDTH * architecture.action_len()];
        for (index, sample) in samples.chunks_exact_mut(architecture.action_len()).enumerate() {
            let Some((_, stream)) = &mut self.rows[index].episode else { continue };
            let mean = self.play.mode == Mode::Deterministic
                || draws_mean(self.play.mean_action_probability, stream);
            let row = self.policy.row(&answers, index);
            if mean { row.mean(sample) } else { row.sample(stream, sample) }
        }
        samples.into_iter().map(|sample| to_action(architecture.family, sample)).collect()
    }

    /// Takes one step in one row; returns its episode if it ended.
    fn act(&mut self, index: usize, action: &[f32]) -> Result<Option<PlayedEpisode>, EnvError> {
        let row = &mut self.rows[index];
        let Some((played, _)) = &mut row.episode else { return Ok(None) };
        if self.play.record {
            match row.env.frame() {
                Frame::Image(pixels) => played.frames.extend_from_slice(pixels),
                Frame::Vector(vector) => played.vectors.extend_from_slice(vector),
            }
            played.actions.extend_from_slice(action);
        }
        let step = row.env.step(action)?;
        played.score += step.reward;
        played.steps += 1;
        played.outcome = step.outcome;
        let newest = index * self.depth + self.depth - 1;
        self.frames.shift(newest, self.depth);
        self.frames.set_scaled(newest, row.env.frame(), false, self.policy.statistics.as_ref());
        Ok(if step.outcome.ended() { row.episode.take().map(|(played, _)| played) } else { None })
    }
}

#[cfg(test)]
#[path = "act_tests.rs"]
mod tests;
