//! `ensemble`: the policies whose disagreement DRIL penalises.

use dril_envs::DEMONSTRATIONS;
use dril_stage_api::{Artifact, Describe, Needs, Ports, Problems};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use crate::artifacts::ENSEMBLE;
use crate::bc::check_fraction;
use crate::columns::EPOCH_COLUMNS;
use crate::update::NO_PRECISION;
use crate::{Device, Split};

/// Trains an ensemble of policies, each on its own bootstrap sample of the demonstrations (Brantley et al. 2020).
#[derive(Clone, Copy, Debug)]
pub struct Ensemble;

/// Size of each member's bootstrap sample.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "kebab-case")]
pub enum Bootstrap {
    /// As many transitions as the training data, as the method prescribes.
    Full,
    /// An `n_members`-th of the training data, as the thesis's code does to save memory.
    Shrunk,
}

/// Parameters of an `ensemble` stage (`with:`).
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields, default)]
pub struct EnsembleParams {
    /// Number of policies.
    pub n_members: u64,
    /// Number of epochs (passes over the bootstrap samples). The last weights are kept.
    pub n_epochs: u64,
    /// Transitions per gradient step, divided evenly among the members (rounded down to a multiple of `n_members`). The
    /// last partial batch of an epoch is dropped; fewer transitions than a batch form one.
    pub batch_size: u64,
    /// Learning rate of Adam.
    pub learning_rate: f64,
    /// Fraction of the transitions held out for validation.
    pub validation_fraction: f64,
    /// How transitions are held out.
    pub split: Split,
    /// Size of each member's bootstrap sample.
    pub bootstrap: Bootstrap,
    /// Device that computes the networks. Devices differ in the last bits, so it is part of the key.
    pub device: Device,
}

impl Default for EnsembleParams {
    fn default() -> Self {
        Self {
            n_members: 5,
            n_epochs: 2001,
            batch_size: 100,
            learning_rate: 2.5e-4,
            validation_fraction: 0.2,
            split: Split::Pairs,
            bootstrap: Bootstrap::Shrunk,
            device: Device::Cpu,
        }
    }
}

impl Describe for Ensemble {
    const KIND: &'static str = "ensemble";
    const REVISION: u32 = 3;
    const ABOUT: &'static str = "trains an ensemble of policies on bootstrap samples of the demonstrations";
    const RENAMED: &'static [(&'static str, &'static str)] =
        &[("members", "n_members"), ("epochs", "n_epochs")];
    const REMOVED: &'static [(&'static str, &'static str)] = &[NO_PRECISION];
    type Params = EnsembleParams;

    fn check(params: &EnsembleParams, problems: &mut Problems) {
        problems.range("n_members", params.n_members, 2.., "at least 2: a single policy cannot disagree");
        problems.positive("n_epochs", params.n_epochs);
        problems.positive_number("learning_rate", params.learning_rate);
        check_fraction(params.validation_fraction, problems);
        if params.batch_size < params.n_members {
            let message = format!(
                "`batch_size` is {}, expected at least one transition for each of the {} `n_members`",
                params.batch_size, params.n_members
            );
            problems.add("batch_size", message);
        }
    }

    fn ports(_: &EnsembleParams) -> Ports {
        Ports::new()
            .input("demonstrations", DEMONSTRATIONS, "the demonstrations to imitate")
            .output("ensemble", ENSEMBLE, "safetensors", "the ensemble")
            .output("log", Artifact::TRAINING_LOG, "csv", "one row per epoch")
            .columns(&EPOCH_COLUMNS)
    }

    fn needs(params: &EnsembleParams) -> Needs {
        Needs::seconds(1.0 + 6.0 * params.n_epochs as f64)
    }
}
