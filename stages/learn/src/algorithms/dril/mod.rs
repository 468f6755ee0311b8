//! `dril`: disagreement-regularised imitation learning (Brantley et al. 2020).
//!
//! PPO on a reward for actions on which the ensemble agrees, with one step of behaviour cloning after each step of PPO:
//! two losses on one network, each with its own optimizer. This file has the hooks into the loop of
//! [`super::on_policy`]; the reward is in `signal`, the selection of the peak policy in `peak`.

mod cloning;
pub mod disagreement;
mod peak;
pub(crate) mod signal;
#[cfg(test)]
mod tests;
mod u_signal;

use dril_envs::VecEnv;
use dril_kinds::{DRIL_COLUMNS, DrilParams};
use dril_stage_api::{Ctx, Stage, StageError};
use serde::{Deserialize, Serialize};

use super::ensemble::Ensemble;
use super::on_policy::{Hooks, Settings, Trained, Training};
use super::ppo::LearnError;
use crate::data::split::divide;
use crate::data::transitions::Transitions;
use crate::policy::Policy;
use crate::spaces;
use crate::training::checkpoint::Arrays;
use crate::training::rollout::Rollout;

use cloning::{Cloning, CloningState};
use peak::PeakTracker;
use signal::{RolloutSignal, Signal, SignalState};

/// The stage `dril`.
#[derive(Clone, Copy, Debug)]
pub struct DrilStage;

impl Stage for DrilStage {
    type Kind = dril_kinds::Dril;

    fn run(params: &DrilParams, ctx: &mut Ctx<'_>) -> Result<(), StageError> {
        let mut policy = Policy::load("policy", ctx.input("policy")?)?;
        let mut ensemble = Ensemble::load("ensemble", ctx.input("ensemble")?)?;
        let transitions = Transitions::load("demonstrations", ctx.input("demonstrations")?)?;
        check(params, &policy, &ensemble, &transitions)?;
        policy.network_mut().set_device(params.on_policy.device)?;
        ensemble.network_mut().set_device(params.on_policy.device)?;
        let envs =
            VecEnv::new(&params.env, params.on_policy.n_envs as usize, 1).map_err(StageError::failed)?;
        let settings =
            Settings::new(&params.on_policy, params.update, params.algorithm, params.on_divergence);
        // The same stream as in `bc`: both train on the same part of the demonstrations, as in the reference code.
        let train =
            divide(transitions.lengths(), params.validation_fraction, params.split, &mut ctx.stream("split"))
                .train;
        let training = Training::start(settings, policy, envs, ctx, |policy, saved| {
            let cloning = Cloning::new(policy, &transitions, train, params, ctx.seed());
            Dril::start(params, (&ensemble, &transitions), policy, cloning, saved)
        })?;
        let Trained { mut policy, hooks, log, episodes } = training.run(ctx)?;
        ctx.write_output("final", policy.to_bytes()?)?;
        for (port, weights) in [("peak", &hooks.peak), ("peak-after", &hooks.peak_after)] {
            policy.params_mut().set_values(weights);
            ctx.write_output(port, policy.to_bytes()?)?;
        }
        ctx.write_output("log", log.to_csv()?)?;
        ctx.write_output("episodes", episodes.to_csv()?)
    }
}

/// Checks that all inputs have the same observation and action space.
fn check(
    params: &DrilParams,
    policy: &Policy,
    ensemble: &Ensemble,
    transitions: &Transitions,
) -> Result<(), StageError> {
    spaces::check(policy, &params.env)?;
    if policy.statistics.is_some() {
        return Err(StageError::failed(
            "the input `policy` normalises observations, but the ensemble was trained without normalisation; use a \
             policy that was cloned from the demonstrations (kind `bc`)",
        ));
    }
    let (observation, actions) = spaces::of(&params.env)?;
    let about = ensemble.architecture();
    for (what, seen) in [
        ("ensemble", (about.observation, about.actions)),
        ("demonstrations", (transitions.observation(), transitions.action_space())),
    ] {
        if seen != (observation, actions) {
            return Err(StageError::failed(format!(
                "the input `{what}` has observations {:?} and {}, but `env` has observations {observation:?} and {}; set \
                 `env` to the environment that the demonstrations were recorded in",
                seen.0,
                spaces::describe(seen.1),
                spaces::describe(actions)
            )));
        }
    }
    Ok(())
}

/// The hooks of DRIL.
struct Dril<'a> {
    peak_reset_updates: u64,
    signal: Signal<'a>,
    cloning: Cloning<'a>,
    tracker: PeakTracker,
    /// True if the current rollout raised the moving average of scores to its maximum.
    is_peak: bool,
    /// Rewards of the current rollout.
    rewards: RolloutSignal,
    /// The weights with the highest moving average so far; initially the weights at the start.
    peak: Vec<f32>,
    /// The same weights after the update that followed.
    peak_after: Vec<f32>,
}

/// The part of a checkpoint besides arrays.
#[derive(Serialize, Deserialize)]
struct State {
    signal: SignalState,
    cloning: CloningState,
    tracker: PeakTracker,
    is_peak: bool,
    rewards: RolloutSignal,
}

impl<'a> Dril<'a> {
    /// Starts, or resumes from a checkpoint.
    fn start(
        params: &DrilParams,
        (ensemble, transitions): (&'a Ensemble, &Transitions),
        policy: &Policy,
        mut cloning: Cloning<'a>,
        saved: Option<(State, &mut Arrays)>,
    ) -> Result<Self, StageError> {
        let initial = policy.params().values();
        let peak_reset_updates = params.peak_reset_updates;
        let Some((state, arrays)) = saved else {
            return Ok(Self {
                peak_reset_updates,
                signal: Signal::new(ensemble, transitions, params)?,
                cloning,
                tracker: PeakTracker::new(params.peak_window as usize),
                is_peak: false,
                rewards: RolloutSignal::default(),
                peak: initial.to_vec(),
                peak_after: initial.to_vec(),
            });
        };
        cloning.restore(state.cloning, arrays)?;
        Ok(Self {
            peak_reset_updates,
            signal: Signal::restored(ensemble, params.reward, state.signal),
            cloning,
            tracker: state.tracker,
            is_peak: state.is_peak,
            rewards: state.rewards,
            peak: arrays.take_f32("peak", initial.len())?,
            peak_after: arrays.take_f32("peak_after", initial.len())?,
        })
    }
}

impl Hooks for Dril<'_> {
    type State = State;

    const COLUMNS: &'static [&'static str] = &DRIL_COLUMNS;

    fn episode_ended(&mut self, score: f64) {
        self.tracker.finished(score);
    }

    /// Replaces the environment's rewards by the ensemble's, and compares the scores with the best so far: they belong to
    /// the weights before this update.
    fn rollout_ended(
        &mut self,
        rollout: &mut Rollout,
        policy: &Policy,
        update: u64,
    ) -> Result<Vec<f64>, StageError> {
        let (rewards, signals) = self.signal.replace_rewards(rollout)?;
        self.rewards = rewards;
        if self.peak_reset_updates > 0 && update.is_multiple_of(self.peak_reset_updates) {
            self.tracker.forget();
        }
        self.is_peak = self.tracker.check(update);
        if self.is_peak {
            self.peak.copy_from_slice(policy.params().values());
        }
        Ok(signals)
    }

    fn minibatch_learnt(&mut self, policy: &mut Policy) -> Result<(), LearnError> {
        self.cloning.step(policy)
    }

    fn update_ended(&mut self, policy: &Policy) {
        if self.is_peak {
            self.peak_after.copy_from_slice(policy.params().values());
        }
    }

    fn log_row(&mut self) -> Vec<f64> {
        let best = self.tracker.best();
        vec![
            self.rewards.u_signal.unwrap_or(f64::NAN),
            self.rewards.disagreement,
            self.cloning.mean_loss(),
            best.map_or(f64::NAN, |peak| peak.update as f64),
            best.map_or(f64::NAN, |peak| peak.mean),
            best.map_or(f64::NAN, |peak| peak.episodes as f64),
        ]
    }

    fn save(&self, arrays: &mut Arrays) -> State {
        arrays.put_f32("peak", &self.peak);
        arrays.put_f32("peak_after", &self.peak_after);
        State {
            signal: self.signal.state().clone(),
            cloning: self.cloning.save(arrays),
            tracker: self.tracker.clone(),
            is_peak: self.is_peak,
            rewards: self.rewards,
        }
    }
}
