//! `dril`: disagreement-regularised imitation learning.

use dril_envs::EnvConfig;
use dril_stage_api::{Artifact, Describe, Needs, Ports, Problems};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use crate::bc::{check_fraction, pairs};
use crate::update::{check_env, check_run};
use crate::{Algorithm, Precision, Split, UpdateSettings, default};

/// Disagreement-regularised imitation learning (Brantley et al. 2020): PPO on the reward that an ensemble's agreement
/// gives, with a step of behaviour cloning after each step of PPO.
#[derive(Clone, Copy, Debug)]
pub struct Dril;

/// What an action is worth, by whether the ensemble's disagreement on it is above the threshold.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "kebab-case")]
pub enum RewardScheme {
    /// +1 up to the threshold, -1 above: what the thesis uses. Finishing a lap early then forgoes rewards.
    PlusMinusOne,
    /// 0 up to the threshold, -1 above. Ending an episode early then avoids punishment.
    MinusOneToZero,
}

/// Which weights are kept as the peak of a training run.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "kebab-case")]
pub enum PeakWeights {
    /// Those that earned the score: the weights before the update.
    Before,
    /// Those after the update, as the code behind the thesis saves them: one update late.
    After,
}

/// Which threshold the disagreement on a choice is held against.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "kebab-case")]
pub enum Thresholds {
    /// Each choice has its own, as the thesis describes it (figure 17).
    #[default]
    PerChoice,
    /// The last choice's stands for all, as a slip in the reference code has it (functions made in a loop that all see
    /// its last round).
    LastChoice,
}

/// What stands under `with:` of a `dril` stage.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct DrilParams {
    /// The environment.
    pub env: EnvConfig,
    /// Environment steps in all, over all `envs`; a remainder below one rollout is not run (3,000,000 are 366 updates).
    #[serde(default = "default::int::<3_000_000>")]
    pub total_steps: u64,
    /// Environments side by side.
    #[serde(default = "default::int::<4>")]
    pub envs: u64,
    /// Steps of each environment between updates.
    #[serde(default = "default::int::<2048>")]
    pub rollout_steps: u64,
    /// Passes over each rollout.
    #[serde(default = "default::int::<10>")]
    pub epochs: u64,
    /// Minibatches a pass (their number, not their size).
    #[serde(default = "default::int::<32>")]
    pub minibatches: u64,
    /// Step size of PPO's Adam. The thesis says 3e-4; every reported checkpoint was made with 2.5e-4.
    #[serde(default = "default::ratio::<25, 100_000>")]
    pub learning_rate: f64,
    /// Lowers PPO's learning rate linearly to 0 over the run.
    #[serde(default = "default::yes")]
    pub anneal_learning_rate: bool,
    /// ε of the clipped surrogate and of the clipped value loss.
    #[serde(default = "default::ratio::<1, 5>")]
    pub clip_range: f64,
    /// Weight of the entropy bonus.
    #[serde(default)]
    pub entropy_coef: f64,
    /// Weight of the value loss.
    #[serde(default = "default::ratio::<1, 2>")]
    pub value_coef: f64,
    /// Global norm to which PPO's gradients are clipped.
    #[serde(default = "default::ratio::<1, 2>")]
    pub max_grad_norm: f64,
    /// Discount.
    #[serde(default = "default::ratio::<99, 100>")]
    pub gamma: f64,
    /// λ of generalised advantage estimation.
    #[serde(default = "default::ratio::<95, 100>")]
    pub gae_lambda: f64,
    /// ε of PPO's Adam.
    #[serde(default = "default::ratio::<1, 100_000>")]
    pub adam_epsilon: f64,
    /// The quantile of the demonstrations' disagreement that is the threshold.
    #[serde(default = "default::ratio::<98, 100>")]
    pub quantile: f64,
    /// What an action is worth.
    #[serde(default = "plus_minus_one")]
    pub reward: RewardScheme,
    /// Divides rewards by the running deviation of their discounted sum.
    #[serde(default = "default::yes")]
    pub normalize_reward: bool,
    /// Pairs in the step of behaviour cloning after each minibatch of PPO.
    #[serde(default = "default::int::<100>")]
    pub bc_batch_size: u64,
    /// Step size of behaviour cloning's own Adam.
    #[serde(default = "default::ratio::<25, 100_000>")]
    pub bc_learning_rate: f64,
    /// Share of the demonstrations that behaviour cloning does not see. (The thesis says that it sees all; its code
    /// keeps a fifth out.)
    #[serde(default = "default::ratio::<1, 5>")]
    pub validation_fraction: f64,
    /// How data is held out.
    #[serde(default = "pairs")]
    pub split: Split,
    /// Episodes whose mean score decides on the peak: the last ones of all environments, looked at once an update; fewer
    /// while fewer have ended. Where none ends in the whole run, the peak is the agent that training began with.
    #[serde(default = "default::int::<10>")]
    pub peak_window: u64,
    /// Updates after which the best score is forgotten, so that a later, lower peak takes its place; 0: never. The
    /// reference has 100 (its author chose among the saved peaks by hand).
    #[serde(default)]
    pub peak_reset_updates: u64,
    /// Which weights are kept as the peak.
    #[serde(default = "before")]
    pub peak: PeakWeights,
    /// Values the state after a time limit instead of taking the limit for a real end, as the reference does (`false`).
    #[serde(default)]
    pub bootstrap_time_limits: bool,
    /// Probability, drawn once for all environments at each step, of acting by the mean in training; the reference's
    /// is 0.1.
    #[serde(default = "default::ratio::<1, 10>")]
    pub mean_action_probability: f64,
    /// How the agent learns from a rollout. The original DRIL has `a2c` for Atari games.
    #[serde(default, skip_serializing_if = "default::is")]
    #[schemars(extend("default" = "ppo"))]
    pub algorithm: Algorithm,
    /// Which threshold the disagreement on a choice is held against; for environments that take choices.
    #[serde(default, skip_serializing_if = "default::is")]
    #[schemars(extend("default" = "per-choice"))]
    pub thresholds: Thresholds,
    /// The numbers that the agent computes with. What the ensemble answers is always computed with 32 bits.
    #[serde(default, skip_serializing_if = "default::is")]
    #[schemars(extend("default" = "fp32"))]
    pub precision: Precision,
}

fn plus_minus_one() -> RewardScheme {
    RewardScheme::PlusMinusOne
}

fn before() -> PeakWeights {
    PeakWeights::Before
}

impl DrilParams {
    /// The settings of an update.
    pub fn update(&self) -> UpdateSettings {
        UpdateSettings {
            algorithm: self.algorithm,
            epochs: self.epochs,
            minibatches: self.minibatches,
            clip_range: self.clip_range,
            entropy_coef: self.entropy_coef,
            value_coef: self.value_coef,
            max_grad_norm: self.max_grad_norm,
            gamma: self.gamma,
            gae_lambda: self.gae_lambda,
        }
    }
}

impl Describe for Dril {
    const KIND: &'static str = "dril";
    const REVISION: u32 = 2;
    const ABOUT: &'static str =
        "imitates by PPO on an ensemble's agreement, interleaved with behaviour cloning";
    type Params = DrilParams;

    fn check(params: &DrilParams, problems: &mut Problems) {
        check_env(&params.env, problems);
        check_run(params.total_steps, params.envs, params.rollout_steps, problems);
        params.update().check(params.envs, params.rollout_steps, problems);
        problems.positive_number("learning_rate", params.learning_rate);
        problems.positive_number("adam_epsilon", params.adam_epsilon);
        problems.positive_number("bc_learning_rate", params.bc_learning_rate);
        problems.positive("bc_batch_size", params.bc_batch_size);
        problems.positive("peak_window", params.peak_window);
        problems.fraction("quantile", params.quantile);
        problems.fraction("mean_action_probability", params.mean_action_probability);
        check_fraction(params.validation_fraction, problems);
    }

    fn ports(_: &DrilParams) -> Ports {
        Ports::new()
            .input("policy", Artifact::Policy, "the cloned behaviour to start from")
            .input("ensemble", Artifact::Ensemble, "the policies whose disagreement is punished")
            .input("demonstrations", Artifact::Demonstrations, "what to imitate")
            .output("peak", Artifact::Policy, "safetensors", "the agent of the best mean training score")
            .output("final", Artifact::Policy, "safetensors", "the agent after the last update")
            .output("log", Artifact::TrainingLog, "csv", "one row per update")
    }

    fn needs(params: &DrilParams) -> Needs {
        let steps = params.total_steps as f64;
        Needs::seconds(1.0 + steps / 2500.0 + steps * params.epochs as f64 / 1200.0)
    }
}
