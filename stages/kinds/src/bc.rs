//! `bc`: behaviour cloning.

use crate::artifacts::POLICY;
use dril_envs::DEMONSTRATIONS;
use dril_stage_api::{Artifact, Describe, Needs, Ports, Problems};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use crate::default::defaults;
use crate::update::NO_PRECISION;
use crate::{Device, Network, PolicyFamily};

/// Behaviour cloning: fits an agent's mean action to the demonstrated ones, with early stopping.
#[derive(Clone, Copy, Debug)]
pub struct Bc;

/// How demonstrations are divided into training and validation data.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "kebab-case")]
pub enum Split {
    /// By single pairs of observation and action, as the reference does. Neighbouring frames fall on both sides, so
    /// validation is optimistic.
    #[default]
    Pairs,
    /// By whole trajectories; a single trajectory is cut into two blocks.
    Trajectories,
}

/// Which of the held-out pairs the validation loss is computed on.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "kebab-case")]
pub enum Validation {
    /// All of them, each time.
    #[default]
    All,
    /// Whole batches of the set, shuffled anew for each pass, as in the reference code: what does not fill a batch is left
    /// out. With one trajectory, that is one random batch of `batch_size` pairs. Fewer pairs than a batch are one batch.
    AsReference,
}

/// What stands under `with:` of a `bc` stage.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct BcParams {
    /// The distribution over actions.
    pub policy: PolicyFamily,
    /// The layers; by default those that fit the observation: `dril-cnn` or `mlp`.
    #[serde(default)]
    pub network: Option<Network>,
    /// Passes over the training data at most.
    #[serde(default = "default::n_epochs")]
    pub n_epochs: u64,
    /// Passes without a better validation loss after which training ends; the best weights are kept.
    #[serde(default = "default::patience")]
    pub patience: u64,
    /// Pairs a step. The thesis says 32; its code has 100. What does not fill a batch at the end of a pass is left out;
    /// fewer pairs than a batch are one batch.
    #[serde(default = "default::batch_size")]
    pub batch_size: u64,
    /// Adam's step size.
    #[serde(default = "default::learning_rate")]
    pub learning_rate: f64,
    /// Share of the data that is held out.
    #[serde(default = "default::validation_fraction")]
    pub validation_fraction: f64,
    /// How data is held out.
    #[serde(default)]
    pub split: Split,
    /// Which of the held-out pairs the validation loss is computed on.
    #[serde(default)]
    pub validation: Validation,
    /// Where networks are computed; other devices give other bits, so it is part of the key.
    #[serde(default)]
    pub device: Device,
}

defaults! {
    n_epochs: u64 = 2001;
    patience: u64 = 20;
    batch_size: u64 = 100;
    learning_rate: f64 = 2.5e-4;
    validation_fraction: f64 = 0.2;
}

impl Describe for Bc {
    const KIND: &'static str = "bc";
    const REVISION: u32 = 3;
    const ABOUT: &'static str = "clones a demonstrated behaviour, with early stopping";
    const RENAMED: &'static [(&'static str, &'static str)] = &[("max_epochs", "n_epochs")];
    const REMOVED: &'static [(&'static str, &'static str)] = &[NO_PRECISION];
    type Params = BcParams;

    fn check(params: &BcParams, problems: &mut Problems) {
        problems.positive("n_epochs", params.n_epochs);
        problems.positive("patience", params.patience);
        problems.positive("batch_size", params.batch_size);
        problems.positive_number("learning_rate", params.learning_rate);
        check_fraction(params.validation_fraction, problems);
    }

    fn ports(_: &BcParams) -> Ports {
        Ports::new()
            .input("demonstrations", DEMONSTRATIONS, "what to imitate")
            .output("policy", POLICY, "safetensors", "the agent with the best validation loss")
            .output("log", Artifact::TRAINING_LOG, "csv", "one row per epoch")
    }

    fn needs(params: &BcParams) -> Needs {
        Needs::seconds(1.0 + 2.0 * params.n_epochs.min(100) as f64)
    }
}

/// Reports a share of held-out data that leaves nothing on one side.
pub(crate) fn check_fraction(value: f64, problems: &mut Problems) {
    if !(value > 0.0 && value < 1.0) {
        problems.add(
            "validation_fraction",
            format!("`validation_fraction` is {value}, expected a number more than 0 and less than 1"),
        );
    }
}
