//! `dril`: disagreement-regularised imitation learning.

use crate::artifacts::{ENSEMBLE, POLICY};
use dril_envs::DEMONSTRATIONS;
use dril_envs::EnvConfig;
use dril_stage_api::{Artifact, Describe, Needs, Part, Ports, Problems};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use crate::bc::check_fraction;
use crate::default::defaults;
use crate::on_policy::{self, OnPolicyParams};
use crate::update::{NO_PRECISION, check_env};
use crate::{Algorithm, OnDivergence, Split, UpdateSettings};

/// Disagreement-regularised imitation learning (Brantley et al. 2020): PPO on the reward that an ensemble's agreement
/// gives, with a step of behaviour cloning after each step of PPO.
#[derive(Clone, Copy, Debug)]
pub struct Dril;

/// What an action is worth, by whether the ensemble's disagreement on it is above the threshold.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "kebab-case")]
pub enum RewardScheme {
    /// +1 up to the threshold, -1 above: what the thesis uses. Finishing a lap early then forgoes rewards.
    #[default]
    PlusMinusOne,
    /// 0 up to the threshold, -1 above. Ending an episode early then avoids punishment.
    MinusOneToZero,
    /// +1 whatever the ensemble says: the control that shows what its signal is worth.
    Constant,
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
    /// What `dril` shares with `ppo`. The thesis says a `learning_rate` of 3e-4; every reported checkpoint was made with
    /// 2.5e-4.
    #[serde(flatten)]
    pub on_policy: OnPolicyParams,
    /// The quantile of the demonstrations' disagreement that is the threshold.
    #[serde(default = "default::quantile")]
    pub quantile: f64,
    /// What an action is worth.
    #[serde(default)]
    pub reward: RewardScheme,
    /// Pairs in the step of behaviour cloning after each minibatch of PPO.
    #[serde(default = "default::bc_batch_size")]
    pub bc_batch_size: u64,
    /// Step size of behaviour cloning's own Adam.
    #[serde(default = "default::bc_learning_rate")]
    pub bc_learning_rate: f64,
    /// Share of the demonstrations that behaviour cloning does not see. (The thesis says that it sees all; its code
    /// keeps a fifth out.)
    #[serde(default = "default::validation_fraction")]
    pub validation_fraction: f64,
    /// How data is held out.
    #[serde(default)]
    pub split: Split,
    /// Episodes whose mean score decides on the peak: the last ones of all environments, looked at once an update; fewer
    /// while fewer have ended. Where none ends in the whole run, the peak is the agent that training began with.
    #[serde(default = "default::peak_window")]
    pub peak_window: u64,
    /// Updates after which the best score is forgotten, so that a later, lower peak takes its place; 0: never. The
    /// reference has 100 (its author chose among the saved peaks by hand).
    #[serde(default)]
    pub peak_reset_updates: u64,
    /// How the agent learns from a rollout. The original DRIL has `a2c` for Atari games.
    #[serde(default)]
    pub algorithm: Algorithm,
    /// Which threshold the disagreement on a choice is held against; for environments that take choices.
    #[serde(default)]
    pub thresholds: Thresholds,
    /// What happens when an update diverges. By default the peak and the last finite weights are written and marked, so
    /// that a table is not lost for one of its trainings.
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

impl DrilParams {
    /// The settings of an update.
    pub fn update(&self) -> UpdateSettings {
        self.on_policy.update(self.algorithm)
    }
}

impl Describe for Dril {
    const KIND: &'static str = "dril";
    const REVISION: u32 = 3;
    const ABOUT: &'static str =
        "imitates by PPO on an ensemble's agreement, interleaved with behaviour cloning";
    const FLATTENED: &'static [Part] = on_policy::PARTS;
    const RENAMED: &'static [(&'static str, &'static str)] = on_policy::RENAMED;
    const REMOVED: &'static [(&'static str, &'static str)] = &[
        NO_PRECISION,
        (
            "peak",
            "both are written: output `peak` has the weights before the update, `peak-after` those after it",
        ),
    ];
    type Params = DrilParams;

    fn check(params: &DrilParams, problems: &mut Problems) {
        check_env(&params.env, problems);
        params.on_policy.check(0, problems);
        problems.positive_number("bc_learning_rate", params.bc_learning_rate);
        problems.positive("bc_batch_size", params.bc_batch_size);
        problems.positive("peak_window", params.peak_window);
        problems.fraction("quantile", params.quantile);
        check_fraction(params.validation_fraction, problems);
    }

    fn ports(_: &DrilParams) -> Ports {
        Ports::new()
            .input("policy", POLICY, "the cloned behaviour to start from")
            .input("ensemble", ENSEMBLE, "the policies whose disagreement is punished")
            .input("demonstrations", DEMONSTRATIONS, "what to imitate")
            .output(
                "peak",
                POLICY,
                "safetensors",
                "the agent of the best mean training score: the weights that earned it",
            )
            .output(
                "peak-after",
                POLICY,
                "safetensors",
                "the same after the update that followed, which the reference saves",
            )
            .output("final", POLICY, "safetensors", "the agent after the last update")
            .output("log", Artifact::TRAINING_LOG, "csv", "one row per update")
            .output("episodes", Artifact::TRAINING_LOG, "csv", "one row per episode of the training")
    }

    fn needs(params: &DrilParams) -> Needs {
        let steps = params.on_policy.to_step() as f64;
        Needs::seconds(1.0 + steps / 2500.0 + steps * params.on_policy.n_epochs as f64 / 1200.0)
    }
}
