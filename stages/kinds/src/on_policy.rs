//! Parameters that the on-policy kinds `ppo` and `dril` share, with their defaults and checks.
//!
//! Names are those of Stable-Baselines3 wherever the meaning is the same. The defaults are the same for both kinds; a
//! pipeline states where its experiment differs.

use dril_stage_api::{Part, Problems};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use crate::{Device, UpdateParams};

/// Parameters of rollouts and training that `ppo` and `dril` share, flattened into theirs together with [`UpdateParams`].
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(default)]
pub struct OnPolicyParams {
    /// Total number of environment steps, summed over all `n_envs`. A multiple of one rollout, `n_envs` × `n_steps`.
    pub total_timesteps: u64,
    /// Step at which training stops, if before `total_timesteps`. A multiple of one rollout. The learning rate still
    /// follows the schedule of `total_timesteps`, so a run that stops early is a prefix of the full one.
    pub to_step: Option<u64>,
    /// Number of parallel environments.
    pub n_envs: u64,
    /// Rollout length: steps per environment between updates.
    pub n_steps: u64,
    /// Learning rate of the optimizer.
    pub learning_rate: f64,
    /// Anneals the learning rate linearly to 0 over `total_timesteps`.
    pub anneal_learning_rate: bool,
    /// ε of Adam, added to the denominator for numerical stability (with `a2c`: of RMSprop).
    pub adam_epsilon: f64,
    /// Bootstraps the value at truncation: an episode that reaches the time limit is not treated as terminated. The
    /// imitators of the reference code treat it as terminated (`false`).
    pub bootstrap_time_limits: bool,
    /// Probability per step, drawn once for all environments, of using the mean action instead of a sample. In the
    /// reference code, experts use 0 and imitators 0.1.
    pub mean_action_probability: f64,
    /// Divides rewards by the running standard deviation of the discounted return. `ppo` also clips them to ±10, as the
    /// annex's LunarLander experts do; `dril` does not, like the reference code. Reported scores are not normalised.
    pub normalize_reward: bool,
    /// Device that computes the networks. Devices differ in the last bits, so it is part of the key.
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
            learning_rate: 2.5e-4,
            anneal_learning_rate: true,
            adam_epsilon: 1e-5,
            bootstrap_time_limits: true,
            mean_action_probability: 0.0,
            normalize_reward: false,
            device: Device::Cpu,
        }
    }
}

/// For [`dril_stage_api::Describe::FLATTENED`].
pub(crate) const PARTS: &[Part] = &[Part::of::<UpdateParams>(), Part::of::<OnPolicyParams>()];

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
    /// Size of one rollout: `n_envs` × `n_steps` environment steps.
    pub fn rollout(&self) -> u64 {
        self.n_envs.saturating_mul(self.n_steps)
    }

    /// The step at which training stops: `to_step`, by default `total_timesteps`.
    pub fn to_step(&self) -> u64 {
        self.to_step.unwrap_or(self.total_timesteps)
    }

    /// Reports values out of range, for a training that starts at `from_step`.
    pub(crate) fn check(&self, from_step: u64, problems: &mut Problems) {
        problems.positive("n_envs", self.n_envs);
        problems.positive("n_steps", self.n_steps);
        self.check_leg(from_step, problems);
        problems.positive_number("learning_rate", self.learning_rate);
        problems.positive_number("adam_epsilon", self.adam_epsilon);
        problems.fraction("mean_action_probability", self.mean_action_probability);
    }

    /// Reports step counts that are not whole rollouts, and a training that is empty or too long.
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

/// Reports a number of steps that is not a whole number of rollouts, at least `least` of them, and names the nearest
/// valid numbers. False if it was reported.
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
