//! On-policy training: a loop of rollouts and updates. `ppo` is this loop alone; `dril` adds hooks that replace the
//! rewards and interleave behaviour cloning. The update itself is in [`super::ppo`].
//!
//! The whole state can be saved after every step and every minibatch, and training continues from it bit-identically.

use dril_envs::VecEnv;
use dril_kinds::{Algorithm, OnDivergence, OnPolicyParams, UPDATE_COLUMNS, UpdateParams};
use dril_stage_api::{Ctx, StageError, StreamRng};
use serde::{Deserialize, Serialize, de::DeserializeOwned};

use super::ppo::{LearnError, Update, UpdateStats, gae};
use crate::nn::{Gradients, Optimizer, OptimizerSettings};
use crate::policy::{Parts, Policy};
use crate::training::checkpoint::{self, Arrays, foreign};
use crate::training::episodes::EpisodeLog;
use crate::training::log::{RecentScores, TrainingLog, UpdateSpeed};
use crate::training::normalize::RewardNormalizer;
use crate::training::rollout::{Rollout, Sampler, SamplerSettings, SamplerState};
use crate::training::tensorboard::Curves;

/// The name of the array in a checkpoint that was saved inside an update.
const BEFORE_UPDATE: &str = "weights before the update";

/// The settings of a training.
#[derive(Clone, Debug, PartialEq)]
pub struct Settings {
    /// The stage's parameters for rollouts and training.
    pub params: OnPolicyParams,
    /// The stage's parameters for updates.
    pub update: UpdateParams,
    /// The algorithm of an update.
    pub algorithm: Algorithm,
    /// Environment steps of the whole training that were done before this stage.
    pub from_step: u64,
    /// True if vector observations are normalised.
    pub normalize_observations: bool,
    /// True if the environments' rewards are scaled by [`RewardNormalizer::clipped`]; hooks that replace the rewards scale
    /// theirs themselves.
    pub normalize_reward: bool,
    /// What happens when an update diverges.
    pub on_divergence: OnDivergence,
}

impl Settings {
    /// The settings of a whole training.
    pub fn new(
        params: &OnPolicyParams,
        update: UpdateParams,
        algorithm: Algorithm,
        on_divergence: OnDivergence,
    ) -> Self {
        Self {
            params: params.clone(),
            update,
            algorithm,
            from_step: 0,
            normalize_observations: false,
            normalize_reward: false,
            on_divergence,
        }
    }

    fn n_envs(&self) -> usize {
        self.params.n_envs as usize
    }

    fn updates_in(&self, steps: u64) -> u64 {
        steps / self.params.rollout()
    }

    /// The learning rate of update `update` (from 0) of the whole training.
    fn rate(&self, update: u64) -> f64 {
        let left = 1.0 - update as f64 / self.updates_in(self.params.total_timesteps) as f64;
        self.params.learning_rate * if self.params.anneal_learning_rate { left } else { 1.0 }
    }

    /// How rollouts are collected.
    fn sampler(&self) -> SamplerSettings {
        SamplerSettings {
            mean_action_probability: self.params.mean_action_probability,
            bootstrap_time_limits: self.params.bootstrap_time_limits,
            normalize_observations: self.normalize_observations,
        }
    }
}

/// Hooks by which an algorithm extends the loop. By default, they do nothing.
pub trait Hooks {
    /// State for checkpoints, besides arrays.
    type State: Serialize + DeserializeOwned;
    /// Additional columns of the training log.
    const COLUMNS: &'static [&'static str] = &[];

    /// An episode ended with this score, the sum of the environment's rewards.
    fn episode_ended(&mut self, score: f64) {
        let _ = score;
    }

    /// A rollout of `policy` is complete, and update number `update` (from 0) follows. May replace the rewards. Returns the
    /// U-signal of each episode that ended in the rollout, in order, or nothing.
    ///
    /// # Errors
    /// The algorithm cannot compute its rewards; the training fails.
    fn rollout_ended(
        &mut self,
        rollout: &mut Rollout,
        policy: &Policy,
        update: u64,
    ) -> Result<Vec<f64>, StageError> {
        let _ = (rollout, policy, update);
        Ok(Vec::new())
    }

    /// The policy was updated from a minibatch.
    ///
    /// # Errors
    /// The network diverged.
    fn minibatch_learnt(&mut self, policy: &mut Policy) -> Result<(), LearnError> {
        let _ = policy;
        Ok(())
    }

    /// The update is complete.
    fn update_ended(&mut self, policy: &Policy) {
        let _ = policy;
    }

    /// The values of [`Hooks::COLUMNS`] for this update; NaN for an empty cell.
    fn log_row(&mut self) -> Vec<f64> {
        Vec::new()
    }

    /// Saves the state to a checkpoint.
    fn save(&self, arrays: &mut Arrays) -> Self::State;
}

/// Result of a training.
#[derive(Debug)]
pub struct Trained<H> {
    /// The policy after the last update, or with the last finite weights.
    pub policy: Policy,
    /// The hooks in their final state.
    pub hooks: H,
    /// One row per update.
    pub log: TrainingLog,
    /// One row per finished episode.
    pub episodes: EpisodeLog,
}

/// A training in progress.
pub struct Training<H> {
    settings: Settings,
    policy: Policy,
    hooks: H,
    rollout: Rollout,
    sampler: Sampler,
    optimizer: Optimizer,
    gradients: Gradients,
    progress: Progress,
    /// The weights before the current update, which played the rollout.
    before_update: Vec<f32>,
}

/// The remaining state of a training; part of a checkpoint.
#[derive(Clone, Debug, Serialize, Deserialize)]
struct Progress {
    /// The stream that shuffles minibatches.
    minibatches: StreamRng,
    updates_done: u64,
    /// Steps done in the current rollout.
    t: usize,
    /// The current update.
    update: Option<Update>,
    /// None if rewards are not scaled, or are replaced by the hooks.
    rewards: Option<RewardNormalizer>,
    scores: RecentScores,
    log: TrainingLog,
    episodes: EpisodeLog,
}

/// The part of a checkpoint besides arrays.
#[derive(Serialize, Deserialize)]
struct State<P, S> {
    sampler: SamplerState,
    optimizer_steps: u64,
    progress: P,
    hooks: S,
}

impl<H: Hooks> Training<H> {
    /// Starts a training, or resumes it from its checkpoint. `hooks` creates the algorithm's hooks, from the state in the
    /// checkpoint if there is one.
    ///
    /// # Errors
    /// An environment or the hooks cannot be started, or the checkpoint is from another training.
    pub fn start(
        settings: Settings,
        policy: Policy,
        envs: VecEnv,
        ctx: &Ctx<'_>,
        hooks: impl FnOnce(&Policy, Option<(H::State, &mut Arrays)>) -> Result<H, StageError>,
    ) -> Result<Self, StageError> {
        match checkpoint::load::<State<Progress, H::State>>(ctx.checkpoints())? {
            None => {
                let hooks = hooks(&policy, None)?;
                let mut training = Self::new(settings, policy, envs, ctx, hooks);
                training.sampler.start(&mut training.rollout)?;
                Ok(training)
            }
            Some((state, mut arrays)) => {
                let hooks = hooks(&policy, Some((state.hooks, &mut arrays)))?;
                let mut training = Self::new(settings, policy, envs, ctx, hooks);
                let weights = arrays.take_f32("weights", training.policy.params().values().len())?;
                training.policy.params_mut().set_values(&weights);
                training.optimizer.restore("optimizer", state.optimizer_steps, &mut arrays)?;
                training.rollout.restore(&mut arrays)?;
                training.sampler.restore(state.sampler)?;
                if state.progress.t > training.rollout.steps {
                    return Err(foreign("its rollout is longer"));
                }
                training.progress = state.progress;
                if training.progress.update.is_some() {
                    training.before_update = arrays.take_f32(BEFORE_UPDATE, weights.len())?;
                }
                Ok(training)
            }
        }
    }

    fn new(settings: Settings, mut policy: Policy, envs: VecEnv, ctx: &Ctx<'_>, hooks: H) -> Self {
        let architecture = policy.architecture();
        let epsilon = settings.params.adam_epsilon;
        let optimizer = match settings.algorithm {
            Algorithm::Ppo => OptimizerSettings { epsilon, ..OptimizerSettings::default() },
            Algorithm::A2c => OptimizerSettings::rmsprop(0.99, epsilon),
        };
        let normalizer = || RewardNormalizer::clipped(settings.n_envs(), settings.update.gamma);
        let columns = [&UPDATE_COLUMNS[..], H::COLUMNS].concat();
        Self {
            optimizer: Optimizer::new(policy.params(), policy.params().ids().collect(), optimizer),
            gradients: Gradients::new(policy.params()),
            rollout: Rollout::new(
                architecture.observation,
                architecture.action_len(),
                settings.n_envs(),
                settings.params.n_steps as usize,
            ),
            sampler: Sampler::new(envs, ctx.seed(), settings.sampler(), policy.statistics.take()),
            progress: Progress {
                minibatches: ctx.stream("minibatch"),
                updates_done: settings.updates_in(settings.from_step),
                t: 0,
                update: None,
                rewards: settings.normalize_reward.then(normalizer),
                scores: RecentScores::default(),
                log: TrainingLog::new(&columns),
                episodes: EpisodeLog::default(),
            },
            settings,
            policy,
            hooks,
            before_update: Vec::new(),
        }
    }

    /// Runs the training to its last step.
    ///
    /// # Errors
    /// An environment or the hooks fail, an update diverges where that is an error, or [`StageError::Cancelled`] after a
    /// checkpoint.
    pub fn run(mut self, ctx: &mut Ctx<'_>) -> Result<Trained<H>, StageError> {
        let mut curves = Curves::open(ctx)?;
        let mut speed = UpdateSpeed::from(self.steps_done(), self.progress.t > 0);
        while self.progress.updates_done < self.settings.updates_in(self.settings.params.to_step()) {
            self.gather(ctx, &speed)?;
            if self.progress.update.is_none() {
                self.begin_update()?;
            }
            let outcome = self.learn(ctx)?.and_then(|()| self.check_outputs());
            if outcome.is_err() {
                self.fall_back();
            }
            self.end_update(outcome.is_err());
            speed.update_ended(self.steps_done());
            curves.last_row(self.steps_done(), &self.progress.log)?;
            if let Err(reason) = outcome {
                self.diverged(&reason)?;
                break;
            }
        }
        self.policy.statistics = self.sampler.statistics().cloned();
        let Progress { log, episodes, .. } = self.progress;
        Ok(Trained { policy: self.policy, hooks: self.hooks, log, episodes })
    }

    /// Fills the rollout.
    fn gather(&mut self, ctx: &mut Ctx<'_>, speed: &UpdateSpeed) -> Result<(), StageError> {
        while self.progress.t < self.rollout.steps {
            let finished = self.sampler.step(&self.policy, &mut self.rollout, self.progress.t)?;
            self.progress.t += 1;
            for episode in finished {
                self.progress.scores.push(episode.score);
                self.hooks.episode_ended(episode.score);
                self.progress.episodes.push(self.steps_done(), self.progress.updates_done, &episode);
            }
            let (done, total, mean) =
                (self.steps_done(), self.settings.params.to_step(), self.progress.scores.mean(10));
            ctx.progress(done, total, "steps", || format!("score {mean:.0}{speed}"));
            // Not between a full rollout and its update: the update is saved with its inputs.
            if self.progress.t < self.rollout.steps {
                self.save_if_due(ctx)?;
            }
        }
        Ok(())
    }

    /// Computes advantages from the rollout's rewards and starts the update.
    fn begin_update(&mut self) -> Result<(), StageError> {
        let update = self.progress.updates_done;
        let signals = self.hooks.rollout_ended(&mut self.rollout, &self.policy, update)?;
        self.progress.episodes.add_signals(&signals);
        if let Some(normalizer) = &mut self.progress.rewards {
            normalizer.normalize(&mut self.rollout.rewards, &self.rollout.dones);
        }
        let last = self.policy.values(&self.rollout.observations(self.rollout.steps));
        let UpdateParams { gamma, gae_lambda, .. } = self.settings.update;
        self.progress.update = Some(Update::new(gae(&self.rollout, &last, gamma, gae_lambda)));
        self.before_update = self.policy.params().values().to_vec();
        Ok(())
    }

    /// Processes the remaining minibatches. The inner error says how the network diverged; it keeps its last finite
    /// weights.
    fn learn(&mut self, ctx: &mut Ctx<'_>) -> Result<Result<(), String>, StageError> {
        let rate = self.settings.rate(self.progress.updates_done);
        loop {
            let Progress { update, minibatches, .. } = &mut self.progress;
            let Some(update) = update else { return Ok(Ok(())) };
            let settings = (self.settings.algorithm, &self.settings.update);
            let Some(minibatch) = update.next_minibatch(settings, minibatches) else { return Ok(Ok(())) };
            let (policy, optimizer) = (&mut self.policy, &mut self.optimizer);
            let learner = (policy, optimizer, &mut self.gradients);
            let learnt = update.learn(learner, &self.rollout, &minibatch, settings, rate);
            match learnt.and_then(|()| self.hooks.minibatch_learnt(&mut self.policy)) {
                Ok(()) => self.save_if_due(ctx)?,
                Err(LearnError::Diverged(reason)) => return Ok(Err(reason)),
            }
        }
    }

    /// Checks that the policy can act where the next rollout begins: finite weights may be so large that its outputs are
    /// not finite. The error says so.
    fn check_outputs(&self) -> Result<(), String> {
        let observations = self.rollout.observations(self.rollout.steps);
        let answers = self.policy.infer(&observations, Parts::Both);
        let mut mean = vec![0.0; self.policy.architecture().action_len()];
        let finite = answers.values.iter().enumerate().all(|(env, value)| {
            let row = self.policy.row(&answers, env);
            row.mean(&mut mean);
            value.is_finite() && row.entropy().is_finite() && mean.iter().all(|x| x.is_finite())
        });
        if finite { Ok(()) } else { Err("the outputs of the policy are not finite".to_owned()) }
    }

    /// After an update that diverged: returns to the weights before it if those at its end cannot act.
    fn fall_back(&mut self) {
        if self.check_outputs().is_err() {
            self.policy.params_mut().set_values(&self.before_update);
        }
    }

    /// Logs the update and prepares the next rollout.
    fn end_update(&mut self, diverged: bool) {
        self.hooks.update_ended(&self.policy);
        let stats = self.progress.update.take().map(|update| update.stats(&self.rollout)).unwrap_or_default();
        let row = self.log_row(&stats, diverged);
        let own = self.hooks.log_row();
        self.progress.log.push(&[&row[..], &own].concat());
        self.rollout.begin_next();
        self.progress.updates_done += 1;
        self.progress.t = 0;
    }

    /// The log row of an update, in the order of [`UPDATE_COLUMNS`].
    fn log_row(&self, stats: &UpdateStats, diverged: bool) -> [f64; 14] {
        let Progress { updates_done, scores, .. } = &self.progress;
        [
            *updates_done as f64,
            self.steps_done() as f64,
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
            self.settings.rate(*updates_done),
            f64::from(u8::from(diverged)),
        ]
    }

    /// Marks the policy of a training that diverged, or fails, depending on the settings.
    fn diverged(&mut self, reason: &str) -> Result<(), StageError> {
        let step = self.steps_done();
        match self.settings.on_divergence {
            OnDivergence::Error => Err(StageError::failed(format!(
                "training diverged at step {step}: {reason}; try a lower `learning_rate` or `clip_range`, or set \
                 `on_divergence` to `keep-last-finite`"
            ))),
            OnDivergence::KeepLastFinite => {
                self.policy.diverged_at_step = Some(step);
                Ok(())
            }
        }
    }

    /// Environment steps done, including those before this stage.
    fn steps_done(&self) -> u64 {
        self.progress.updates_done * self.rollout.len() as u64 + (self.progress.t * self.rollout.envs) as u64
    }

    /// Saves a checkpoint if one is due; stops after it if the stage was cancelled.
    fn save_if_due(&self, ctx: &mut Ctx<'_>) -> Result<(), StageError> {
        if ctx.checkpoint_due() {
            let mut arrays = Arrays::new();
            arrays.put_f32("weights", self.policy.params().values());
            if self.progress.update.is_some() {
                arrays.put_f32(BEFORE_UPDATE, &self.before_update);
            }
            self.optimizer.save("optimizer", &mut arrays);
            self.rollout.save(&mut arrays);
            let state = State {
                sampler: self.sampler.state(),
                optimizer_steps: self.optimizer.steps(),
                progress: &self.progress,
                hooks: self.hooks.save(&mut arrays),
            };
            checkpoint::save(ctx.checkpoints(), &state, &arrays)?;
        }
        ctx.stop_if_cancelled()
    }
}
