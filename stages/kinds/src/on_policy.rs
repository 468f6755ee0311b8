//! What the two kinds that learn from their own rollouts, `ppo` and `dril`, share: parameters, their defaults and checks.
//!
//! Names are those of Stable-Baselines3 wherever the meaning is the same. Defaults are literal values, the same for both
//! kinds; a pipeline states where its experiment differs.

use dril_stage_api::{Part, Problems};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use crate::{Algorithm, Device, UpdateSettings};

/// The columns of the output `episodes` (CSV), one row per finished episode, in the order in which they finish (in the
/// order of the environments where several finish at one step):
///
/// - `episode`: its number, from 0;
/// - `step`: environment steps taken by all environments when it ended, counted from the start of the whole training;
/// - `update`: updates done before it ended, counted likewise;
/// - `seed`: the seed that names its track, ground or level;
/// - `score`: the sum of the environment's own rewards;
/// - `length`: its steps;
/// - `u_signal`: the mean over its steps of the reward that the ensemble gave (+1 or -1, before scaling); empty for `ppo`.
pub const EPISODE_COLUMNS: [&str; 7] = ["episode", "step", "update", "seed", "score", "length", "u_signal"];

/// The parameters that `ppo` and `dril` share, flattened into theirs.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(default)]
pub struct OnPolicyParams {
    /// Environment steps in all, over all `n_envs`: a multiple of one rollout, `n_envs` × `n_steps`.
    pub total_timesteps: u64,
    /// Where training ends, if not at `total_timesteps`; a multiple of one rollout too. The learning rate follows the
    /// schedule of the whole: a run that ends early is the beginning of the long one.
    pub to_step: Option<u64>,
    /// Environments side by side.
    pub n_envs: u64,
    /// Steps of each environment between updates.
    pub n_steps: u64,
    /// Passes over each rollout.
    pub n_epochs: u64,
    /// Minibatches a pass: their number, not their size. A remainder of the rollout is dropped.
    pub n_minibatches: u64,
    /// Step size of Adam.
    pub learning_rate: f64,
    /// Lowers the learning rate linearly to 0 over `total_timesteps`.
    pub anneal_learning_rate: bool,
    /// ε of the clipped surrogate and of the clipped value loss.
    pub clip_range: f64,
    /// Weight of the entropy bonus.
    pub ent_coef: f64,
    /// Weight of the value loss.
    pub vf_coef: f64,
    /// Global norm to which gradients are clipped.
    pub max_grad_norm: f64,
    /// Discount.
    pub gamma: f64,
    /// λ of generalised advantage estimation.
    pub gae_lambda: f64,
    /// ε of Adam.
    pub adam_epsilon: f64,
    /// Values the state after a time limit instead of taking the limit for a real end (truncation, not termination). The
    /// imitators of the reference code take it for an end (`false`).
    pub bootstrap_time_limits: bool,
    /// Probability, drawn once for all environments at each step, of acting by the mean although a draw was asked for.
    /// The reference's experts have none; its imitators have 0.1.
    pub mean_action_probability: f64,
    /// Divides rewards by the running deviation of their discounted sum. `ppo` also clips them to ±10, as the annex's
    /// LunarLander experts have it; `dril` does not, as the reference does not. Scores stay those of the environment.
    pub normalize_reward: bool,
    /// Where networks are computed; other devices give other bits, so it is part of the key.
    pub device: Device,
}

impl Default for OnPolicyParams {
    fn default() -> Self {
        Self {
            // 366 rollouts of 4 × 2,048 steps: what a request for 3,000,000 runs in the reference.
            total_timesteps: 2_998_272,
            to_step: None,
            n_envs: 4,
            n_steps: 2048,
            n_epochs: 10,
            n_minibatches: 32,
            learning_rate: 2.5e-4,
            anneal_learning_rate: true,
            clip_range: 0.2,
            ent_coef: 0.0,
            vf_coef: 0.5,
            max_grad_norm: 0.5,
            gamma: 0.99,
            gae_lambda: 0.95,
            adam_epsilon: 1e-5,
            bootstrap_time_limits: true,
            mean_action_probability: 0.0,
            normalize_reward: false,
            device: Device::Cpu,
        }
    }
}

/// For [`dril_stage_api::Describe::FLATTENED`].
pub(crate) const PARTS: &[Part] = &[Part::of::<OnPolicyParams>()];

/// For [`dril_stage_api::Describe::RENAMED`].
pub(crate) const RENAMED: &[(&str, &str)] = &[
    ("total_steps", "total_timesteps"),
    ("envs", "n_envs"),
    ("rollout_steps", "n_steps"),
    ("epochs", "n_epochs"),
    ("minibatches", "n_minibatches"),
    ("entropy_coef", "ent_coef"),
    ("value_coef", "vf_coef"),
];

impl OnPolicyParams {
    /// Steps of one rollout over all environments: `n_envs` × `n_steps`.
    pub fn rollout(&self) -> u64 {
        self.n_envs.saturating_mul(self.n_steps)
    }

    /// The step at which the stage ends: `to_step`, by default `total_timesteps`.
    pub fn to_step(&self) -> u64 {
        self.to_step.unwrap_or(self.total_timesteps)
    }

    /// The settings of an update.
    pub fn update(&self, algorithm: Algorithm) -> UpdateSettings {
        UpdateSettings {
            algorithm,
            n_epochs: self.n_epochs,
            n_minibatches: self.n_minibatches,
            clip_range: self.clip_range,
            ent_coef: self.ent_coef,
            vf_coef: self.vf_coef,
            max_grad_norm: self.max_grad_norm,
            gamma: self.gamma,
            gae_lambda: self.gae_lambda,
        }
    }

    /// Reports what is out of range, for a training that begins at `from_step`.
    pub(crate) fn check(&self, from_step: u64, problems: &mut Problems) {
        problems.positive("n_envs", self.n_envs);
        problems.positive("n_steps", self.n_steps);
        self.check_leg(from_step, problems);
        self.check_minibatches(problems);
        problems.positive("n_epochs", self.n_epochs);
        problems.positive_number("learning_rate", self.learning_rate);
        problems.positive_number("clip_range", self.clip_range);
        problems.range("ent_coef", self.ent_coef, 0.0..=f64::MAX, "at least 0");
        problems.range("vf_coef", self.vf_coef, 0.0..=f64::MAX, "at least 0");
        problems.positive_number("max_grad_norm", self.max_grad_norm);
        problems.fraction("gamma", self.gamma);
        problems.fraction("gae_lambda", self.gae_lambda);
        problems.positive_number("adam_epsilon", self.adam_epsilon);
        problems.fraction("mean_action_probability", self.mean_action_probability);
    }

    fn check_minibatches(&self, problems: &mut Problems) {
        problems.positive("n_minibatches", self.n_minibatches);
        let (count, samples) = (self.n_minibatches, self.rollout());
        if samples > 0 && count > samples {
            let message = format!(
                "`n_minibatches` is {count}, expected at most the {samples} samples of a rollout (`n_envs` × `n_steps`)"
            );
            problems.add("n_minibatches", message);
        }
    }

    /// Reports steps that no update ends at, and a training that is empty or too long.
    fn check_leg(&self, from_step: u64, problems: &mut Problems) {
        let rollout = self.rollout();
        if rollout == 0 {
            // Reported by its factors.
            return;
        }
        let (to_step, total) = (self.to_step(), self.total_timesteps);
        let whole = check_multiple("total_timesteps", total, 1, rollout, problems)
            & self.to_step.is_none_or(|to| check_multiple("to_step", to, 1, rollout, problems))
            & check_multiple("from_step", from_step, 0, rollout, problems);
        if to_step > total {
            let message = format!("`to_step` is {to_step}, expected at most `total_timesteps`: {total}");
            problems.add("to_step", message);
        } else if whole && from_step >= to_step {
            let message = format!(
                "`from_step` is {from_step}, expected at least one rollout ({rollout}) less than {to_step}"
            );
            problems.add("from_step", message);
        }
    }
}

/// Reports a number of steps that is not a whole number of rollouts, at least `least` of them, with the nearest ones
/// that are. False where it was reported.
fn check_multiple(field: &str, steps: u64, least: u64, rollout: u64, problems: &mut Problems) -> bool {
    let rollouts = steps / rollout;
    if steps.is_multiple_of(rollout) && rollouts >= least {
        return true;
    }
    let below = (rollouts >= least.max(1)).then(|| rollouts * rollout);
    let above = (rollouts.max(least.saturating_sub(1)) + 1).checked_mul(rollout);
    let nearest: Vec<String> = below.into_iter().chain(above).map(|steps| steps.to_string()).collect();
    let message = format!(
        "`{field}` is {steps}, expected a multiple of one rollout, {rollout} steps (`n_envs` × `n_steps`), as {}",
        nearest.join(" or ")
    );
    problems.add(field, message);
    false
}
