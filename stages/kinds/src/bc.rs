//! `bc`: behaviour cloning.

use dril_envs::DEMONSTRATIONS;
use dril_stage_api::{Artifact, Describe, Needs, Ports, Problems};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use crate::artifacts::POLICY;
use crate::columns::EPOCH_COLUMNS;
use crate::default::defaults;
use crate::update::NO_PRECISION;
use crate::{Device, Network, PolicyFamily};

/// Behaviour cloning: fits a policy's mean action to the demonstrated actions, with early stopping.
#[derive(Clone, Copy, Debug)]
pub struct Bc;

/// How demonstrations are split into training and validation data.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "kebab-case")]
pub enum Split {
    /// By single transitions (observation and action), as in the reference code. Neighbouring frames end up on both
    /// sides, so the validation loss is optimistic.
    #[default]
    Pairs,
    /// By whole trajectories. A single trajectory is split into two contiguous blocks.
    Trajectories,
}

/// Which held-out transitions the validation loss is computed on.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "kebab-case")]
pub enum Validation {
    /// All of them, after every epoch.
    #[default]
    All,
    /// Full batches of a newly shuffled validation set, as in the reference code; the last partial batch is dropped. With
    /// one trajectory, this is one random batch of `batch_size` transitions. Fewer transitions than a batch form one.
    AsReference,
}

/// Parameters of a `bc` stage (`with:`).
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct BcParams {
    /// Action distribution of the policy.
    pub policy: PolicyFamily,
    /// Network architecture. Default: `dril-cnn` for images, `mlp` for vectors.
    #[serde(default)]
    pub network: Option<Network>,
    /// Maximum number of epochs (passes over the training data).
    #[serde(default = "default::n_epochs")]
    pub n_epochs: u64,
    /// Early stopping: training ends after this many epochs without a lower validation loss. The best weights are kept.
    #[serde(default = "default::patience")]
    pub patience: u64,
    /// Transitions per gradient step. The thesis states 32; its code uses 100. The last partial batch of an epoch is
    /// dropped; fewer transitions than a batch form one.
    #[serde(default = "default::batch_size")]
    pub batch_size: u64,
    /// Learning rate of Adam.
    #[serde(default = "default::learning_rate")]
    pub learning_rate: f64,
    /// Fraction of the transitions held out for validation.
    #[serde(default = "default::validation_fraction")]
    pub validation_fraction: f64,
    /// How transitions are held out.
    #[serde(default)]
    pub split: Split,
    /// Which held-out transitions the validation loss is computed on.
    #[serde(default)]
    pub validation: Validation,
    /// Device that computes the networks. Devices differ in the last bits, so it is part of the key.
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
    const ABOUT: &'static str = "behaviour cloning of demonstrations, with early stopping";
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
            .input("demonstrations", DEMONSTRATIONS, "the demonstrations to imitate")
            .output("policy", POLICY, "safetensors", "the policy with the lowest validation loss")
            .output("log", Artifact::TRAINING_LOG, "csv", "one row per epoch")
            .columns(&EPOCH_COLUMNS)
    }

    fn needs(params: &BcParams) -> Needs {
        Needs::seconds(1.0 + 2.0 * params.n_epochs.min(100) as f64)
    }
}

/// Reports a validation fraction that leaves one side without data.
pub(crate) fn check_fraction(value: f64, problems: &mut Problems) {
    if !(value > 0.0 && value < 1.0) {
        problems.add(
            "validation_fraction",
            format!("`validation_fraction` is {value}, expected a number more than 0 and less than 1"),
        );
    }
}
