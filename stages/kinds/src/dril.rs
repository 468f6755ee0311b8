//! `dril`: disagreement-regularised imitation learning.

use dril_envs::params::check_env;
use dril_envs::{DEMONSTRATIONS, EnvConfig};
use dril_stage_api::{Artifact, Describe, Needs, Part, Ports, Problems};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use crate::artifacts::{ENSEMBLE, POLICY};
use crate::bc::check_fraction;
use crate::columns::{DRIL_COLUMNS, EPISODE_COLUMNS, UPDATE_COLUMNS};
use crate::default::defaults;
use crate::on_policy::{self, OnPolicyParams};
use crate::update::NO_PRECISION;
use crate::{Algorithm, OnDivergence, Split, UpdateParams};

/// Disagreement-regularised imitation learning (DRIL; Brantley et al. 2020): PPO on a reward for actions on which an
/// ensemble agrees, with a gradient step of behaviour cloning after each step of PPO.
#[derive(Clone, Copy, Debug)]
pub struct Dril;

/// Reward of an action, by whether the ensemble's disagreement on it exceeds the threshold.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "kebab-case")]
pub enum RewardScheme {
    /// +1 up to the threshold, -1 above; used by the thesis. Longer episodes can earn more, so finishing early is
    /// discouraged.
    #[default]
    PlusMinusOne,
    /// 0 up to the threshold, -1 above. Ending an episode early avoids penalties.
    MinusOneToZero,
    /// Always +1: an ablation that ignores the ensemble.
    Constant,
}

/// Which threshold the disagreement on a discrete action is compared with.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "kebab-case")]
pub enum Thresholds {
    /// A separate threshold for each action, as the thesis describes (figure 17).
    #[default]
    PerChoice,
    /// The threshold of the last action for all actions. This reproduces a bug of the reference code (closures created in
    /// a loop all capture its last iteration).
    LastChoice,
}

/// Parameters of a `dril` stage (`with:`).
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct DrilParams {
    /// The environment.
    pub env: EnvConfig,
    /// Parameters shared with `ppo`. The thesis states a `learning_rate` of 3e-4; all its reported checkpoints were trained
    /// with 2.5e-4.
    #[serde(flatten)]
    pub on_policy: OnPolicyParams,
    /// How the policy is updated from a rollout.
    #[serde(flatten)]
    pub update: UpdateParams,
    /// Quantile of the disagreement on demonstrated actions that serves as the threshold.
    #[serde(default = "default::quantile")]
    pub quantile: f64,
    /// Reward of an action, given the ensemble's disagreement on it.
    #[serde(default)]
    pub reward: RewardScheme,
    /// Batch size of the behaviour cloning step that follows each PPO minibatch.
    #[serde(default = "default::bc_batch_size")]
    pub bc_batch_size: u64,
    /// Learning rate of behaviour cloning, which has its own Adam optimizer.
    #[serde(default = "default::bc_learning_rate")]
    pub bc_learning_rate: f64,
    /// Fraction of the demonstrations that is held out from behaviour cloning. (The thesis states that it uses all of them;
    /// its code holds out a fifth.)
    #[serde(default = "default::validation_fraction")]
    pub validation_fraction: f64,
    /// How transitions are held out.
    #[serde(default)]
    pub split: Split,
    /// Window of the moving average of scores that selects the peak policy: the latest episodes over all environments,
    /// checked once per update; fewer while fewer have ended. If no episode ends during training, the peak is the initial
    /// policy.
    #[serde(default = "default::peak_window")]
    pub peak_window: u64,
    /// Number of updates after which the best score is reset, so that a later, lower peak can replace it; 0: never. The
    /// reference code uses 100 (its author then chose among the saved peaks by hand).
    #[serde(default)]
    pub peak_reset_updates: u64,
    /// Algorithm that updates the policy. The original DRIL uses `a2c` for Atari games.
    #[serde(default)]
    pub algorithm: Algorithm,
    /// Which threshold applies to a discrete action. No effect for continuous actions.
    #[serde(default)]
    pub thresholds: Thresholds,
    /// What happens when an update diverges. By default, the peak and the last finite weights are written and marked, so
    /// that one diverged run does not prevent a table.
    #[serde(default = "default::on_divergence")]
    pub on_divergence: OnDivergence,
}

defaults! {
    quantile: f64 = 0.98;
    bc_batch_size: u64 = 100;
    bc_learning_rate: f64 = 2.5e-4;
    validation_fraction: f64 = 0.2;
    peak_window: u64 = 10;
    on_divergence: OnDivergence = OnDivergence::KeepLastFinite;
}

impl Describe for Dril {
    const KIND: &'static str = "dril";
    const REVISION: u32 = 3;
    const ABOUT: &'static str = "DRIL: PPO on an ensemble's agreement, interleaved with behaviour cloning";
    const FLATTENED: &'static [Part] = on_policy::PARTS;
    const RENAMED: &'static [(&'static str, &'static str)] = on_policy::RENAMED;
    const REMOVED: &'static [(&'static str, &'static str)] = &[
        NO_PRECISION,
        (
            "peak",
            "both are written: output `peak` has the weights before the update, output `peak-after` those after it",
        ),
    ];
    type Params = DrilParams;

    fn check(params: &DrilParams, problems: &mut Problems) {
        check_env(&params.env, problems);
        params.update.check(params.on_policy.rollout(), problems);
        params.on_policy.check(0, problems);
        problems.positive_number("bc_learning_rate", params.bc_learning_rate);
        problems.positive("bc_batch_size", params.bc_batch_size);
        problems.positive("peak_window", params.peak_window);
        problems.fraction("quantile", params.quantile);
        check_fraction(params.validation_fraction, problems);
    }

    fn ports(_: &DrilParams) -> Ports {
        Ports::new()
            .input("policy", POLICY, "the initial policy, usually from `bc`")
            .input("ensemble", ENSEMBLE, "the ensemble whose disagreement is penalised")
            .input("demonstrations", DEMONSTRATIONS, "the demonstrations to imitate")
            .output(
                "peak",
                POLICY,
                "safetensors",
                "the policy with the highest mean training score, with the weights that earned it",
            )
            .output(
                "peak-after",
                POLICY,
                "safetensors",
                "the same policy after the update that followed, which the reference code saves",
            )
            .output("final", POLICY, "safetensors", "the policy after the last update")
            .output("log", Artifact::TRAINING_LOG, "csv", "one row per update")
            .columns(&[&UPDATE_COLUMNS[..], &DRIL_COLUMNS].concat())
            .output("episodes", Artifact::TRAINING_LOG, "csv", "one row per training episode")
            .columns(&EPISODE_COLUMNS)
    }

    fn needs(params: &DrilParams) -> Needs {
        let steps = params.on_policy.to_step() as f64;
        Needs::seconds(1.0 + steps / 2500.0 + steps * params.update.n_epochs as f64 / 1200.0)
    }
}
