//! `dril`: disagreement-regularised imitation learning (Brantley et al. 2020).
//!
//! PPO on the reward that the ensemble's agreement gives, with one step of behaviour cloning after each step of PPO:
//! two losses on one network, each with an Adam of its own. The whole loop is in `Training::run`; how PPO works is in
//! [`crate::learner`], what rewards are made of in `signal`.

mod cloning;
mod peak;
mod reward;
mod signal;
#[cfg(test)]
mod tests;

use dril_envs::VecEnv;
use dril_kinds::{DrilParams, PeakWeights};
use dril_stage_api::{Ctx, Stage, StageError};
use serde::{Deserialize, Serialize};

use crate::checkpoint::{self, Arrays};
use crate::ensemble::Ensemble;
use crate::fast;
use crate::learner::{LOG_COLUMNS, Learner, LearnerSettings, LearnerState, log_row};
use crate::log::{RecentScores, Speed, TrainingLog};
use crate::made_with;
use crate::pairs::Pairs;
use crate::policy::Policy;
use crate::rollout::SamplerSettings;
use crate::spaces;
use crate::split::divide;
use crate::tensorboard::Curves;

use cloning::{Cloning, CloningState};
use peak::PeakTracker;
use signal::{RolloutSignal, Signal, SignalState};

/// Runs `dril` stages.
#[derive(Clone, Copy, Debug)]
pub struct DrilStage;

impl Stage for DrilStage {
    type Kind = dril_kinds::Dril;

    fn run(params: &DrilParams, ctx: &mut Ctx<'_>) -> Result<(), StageError> {
        fast::prepare();
        made_with::tell(ctx);
        let policy = Policy::load("policy", ctx.input("policy")?)?;
        let ensemble = Ensemble::load("ensemble", ctx.input("ensemble")?)?;
        let pairs = Pairs::load("demonstrations", ctx.input("demonstrations")?)?;
        check(params, &policy, &ensemble, &pairs)?;
        let Trained { mut policy, peak, log } =
            Training::start(params, policy, &ensemble, &pairs, ctx)?.run(ctx)?;
        ctx.write_output("final", policy.to_bytes()?)?;
        policy.params.set_values(&peak);
        ctx.write_output("peak", policy.to_bytes()?)?;
        ctx.write_output("log", log.to_csv()?)
    }
}

/// Checks that all inputs are about the same observations and actions.
fn check(params: &DrilParams, policy: &Policy, ensemble: &Ensemble, pairs: &Pairs) -> Result<(), StageError> {
    spaces::check(policy, &params.env)?;
    if policy.statistics.is_some() {
        return Err(StageError::failed(
            "the input `policy` scales its observations, but the ensemble has learnt from plain ones; give it a policy \
             that was cloned from the demonstrations (kind `bc`)",
        ));
    }
    let (observation, actions) = spaces::of(&params.env)?;
    let about = ensemble.architecture();
    for (what, seen) in [
        ("ensemble", (about.observation, about.kind())),
        ("demonstrations", (pairs.observation(), pairs.kind())),
    ] {
        if seen != (observation, actions) {
            return Err(StageError::failed(format!(
                "the input `{what}` is of {:?} and {}, but `env` shows {observation:?} and takes {actions}; give `env` the \
                 environment that the demonstrations were recorded in",
                seen.0, seen.1
            )));
        }
    }
    Ok(())
}

fn settings(params: &DrilParams) -> LearnerSettings {
    LearnerSettings {
        envs: params.envs as usize,
        rollout_steps: params.rollout_steps as usize,
        total_steps: params.total_steps,
        steps: 0..params.total_steps,
        learning_rate: params.learning_rate,
        anneal_learning_rate: params.anneal_learning_rate,
        adam_epsilon: params.adam_epsilon,
        update: params.update(),
        sampler: SamplerSettings {
            mean_action_probability: params.mean_action_probability,
            bootstrap_time_limits: params.bootstrap_time_limits,
            normalize_observations: false,
        },
        // The signal scales the rewards that it makes.
        normalize_reward: false,
        precision: params.precision,
    }
}

/// The log's columns after those of every training by reinforcement. The last three say which moving average is the
/// highest so far: reached before which update, how high, and over how many episodes (fewer than `peak_window` while
/// fewer have ended; all empty while none has, when the peak's weights are those that training began with).
const OWN_COLUMNS: [&str; 6] =
    ["u_signal", "disagreement", "bc_loss", "peak_update", "peak_score", "peak_episodes"];

/// What training gives.
struct Trained {
    /// The agent after the last update.
    policy: Policy,
    /// The weights of the peak.
    peak: Vec<f32>,
    log: TrainingLog,
}

/// A training under way.
struct Training<'a> {
    params: &'a DrilParams,
    learner: Learner,
    cloning: Cloning<'a>,
    signal: Signal<'a>,
    course: Course,
    /// The weights of the highest moving average so far; those at the start before there is one.
    peak: Vec<f32>,
}

/// What a training remembers of its past.
#[derive(Serialize, Deserialize)]
struct Course {
    scores: RecentScores,
    tracker: PeakTracker,
    /// True where the rollout that is being learnt from brought the moving average to its highest.
    is_peak: bool,
    /// That rollout's rewards.
    rewards: RolloutSignal,
    log: TrainingLog,
}

/// What a checkpoint holds beside the arrays.
#[derive(Serialize, Deserialize)]
struct State<C> {
    learner: LearnerState,
    cloning: CloningState,
    signal: SignalState,
    course: C,
}

impl<'a> Training<'a> {
    /// A training at its start, or where the checkpoint left it.
    fn start(
        params: &'a DrilParams,
        policy: Policy,
        ensemble: &'a Ensemble,
        pairs: &'a Pairs,
        ctx: &Ctx<'_>,
    ) -> Result<Self, StageError> {
        let train =
            divide(pairs.lengths(), params.validation_fraction, params.split, &mut ctx.stream("split")).train;
        let step = (params.bc_batch_size as usize, params.bc_learning_rate);
        let mut cloning = Cloning::new(&policy, pairs, train, step, ctx.seed());
        let mut peak = policy.params.values().to_vec();
        let envs = VecEnv::new(&params.env, params.envs as usize, 1).map_err(StageError::failed)?;
        let mut learner = Learner::new(settings(params), policy, envs, ctx.seed());
        let (signal, course) = match checkpoint::load::<State<Course>>(ctx.checkpoints())? {
            Some((state, mut arrays)) => {
                learner.restore(state.learner, &mut arrays)?;
                cloning.restore(state.cloning, &mut arrays)?;
                peak = arrays.take_f32("peak", peak.len())?;
                (Signal::restored(ensemble, params.reward, state.signal), state.course)
            }
            None => {
                learner.start()?;
                (Signal::new(ensemble, pairs, params)?, Course::new(params))
            }
        };
        Ok(Self { params, learner, cloning, signal, course, peak })
    }

    /// The whole training: rollouts and updates in turn until the steps are used up.
    fn run(mut self, ctx: &mut Ctx<'_>) -> Result<Trained, StageError> {
        let mut curves = Curves::open(ctx)?;
        let speed = Speed::from(self.learner.steps_done());
        while !self.learner.finished() {
            self.gather(ctx, speed)?;
            if !self.learner.updating() {
                self.begin_update()?;
            }
            while let Some(minibatch) = self.learner.next_minibatch() {
                self.learner.learn(&minibatch)?;
                self.cloning.step(&mut self.learner.policy)?;
                self.save_if_due(ctx)?;
            }
            self.end_update();
            curves.last_row(self.learner.steps_done(), &self.course.log)?;
        }
        Ok(Trained { policy: self.learner.into_policy(), peak: self.peak, log: self.course.log })
    }

    /// Fills the rollout.
    fn gather(&mut self, ctx: &mut Ctx<'_>, speed: Speed) -> Result<(), StageError> {
        while !self.learner.rollout_full() {
            for episode in self.learner.step()? {
                self.course.scores.push(episode.score);
                self.course.tracker.finished(episode.score);
            }
            let (done, total) = (self.learner.steps_done(), self.learner.last_step());
            let mean = self.course.scores.mean(10);
            ctx.progress(done, total, "steps", || format!("score {mean:.0}, {:.0} steps/s", speed.at(done)));
            // Not between a full rollout and its update: what the update is made of is saved with it.
            if !self.learner.rollout_full() {
                self.save_if_due(ctx)?;
            }
        }
        Ok(())
    }

    /// Makes rewards of the rollout, and sees whether its episodes are the best so far: they were played with the
    /// weights that this update is about to change.
    fn begin_update(&mut self) -> Result<(), StageError> {
        self.course.rewards = self.signal.replace_rewards(&mut self.learner.rollout)?;
        let update = self.learner.updates_done();
        let period = self.params.peak_reset_updates;
        if period > 0 && update.is_multiple_of(period) {
            self.course.tracker.forget();
        }
        self.course.is_peak = self.course.tracker.check(update);
        self.keep_peak(PeakWeights::Before);
        self.learner.begin_update();
        Ok(())
    }

    fn end_update(&mut self) {
        self.keep_peak(PeakWeights::After);
        let (update, step) = (self.learner.updates_done(), self.learner.steps_done());
        let rate = self.learner.learning_rate();
        let stats = self.learner.end_update();
        let best = self.course.tracker.best();
        let own = [
            self.course.rewards.u_signal.unwrap_or(f64::NAN),
            self.course.rewards.disagreement,
            self.cloning.mean_loss(),
            best.map_or(f64::NAN, |peak| peak.update as f64),
            best.map_or(f64::NAN, |peak| peak.mean),
            best.map_or(f64::NAN, |peak| peak.episodes as f64),
        ];
        let row = log_row(update, step, rate, &self.course.scores, &stats);
        self.course.log.push(&[&row[..], &own[..]].concat());
    }

    /// Keeps the weights of a peak, where this is the time at which they are wanted.
    fn keep_peak(&mut self, now: PeakWeights) {
        if self.course.is_peak && self.params.peak == now {
            self.peak.copy_from_slice(self.learner.policy.params.values());
        }
    }

    /// Saves a checkpoint where it is time; stops after it where a stop was asked for.
    fn save_if_due(&self, ctx: &mut Ctx<'_>) -> Result<(), StageError> {
        if ctx.checkpoint_due() {
            let mut arrays = Arrays::new();
            let state = State {
                learner: self.learner.save(&mut arrays),
                cloning: self.cloning.save(&mut arrays),
                signal: self.signal.state().clone(),
                course: &self.course,
            };
            arrays.put_f32("peak", &self.peak);
            checkpoint::save(ctx.checkpoints(), &state, &arrays)?;
        }
        ctx.stop_if_cancelled()
    }
}

impl Course {
    fn new(params: &DrilParams) -> Self {
        Self {
            scores: RecentScores::default(),
            tracker: PeakTracker::new(params.peak_window as usize),
            is_peak: false,
            rewards: RolloutSignal::default(),
            log: TrainingLog::new(&[&LOG_COLUMNS[..], &OWN_COLUMNS[..]].concat()),
        }
    }
}
