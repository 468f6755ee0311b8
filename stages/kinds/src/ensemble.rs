//! `ensemble`: the policies whose disagreement DRIL punishes.

use crate::artifacts::ENSEMBLE;
use dril_envs::DEMONSTRATIONS;
use dril_stage_api::{Artifact, Describe, Needs, Ports, Problems};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use crate::bc::check_fraction;
use crate::update::NO_PRECISION;
use crate::{Device, Split};

/// Trains an ensemble of policies, each on its own bootstrap of the demonstrations (Brantley et al. 2020).
#[derive(Clone, Copy, Debug)]
pub struct Ensemble;

/// How many pairs a member's bootstrap holds.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "kebab-case")]
pub enum Bootstrap {
    /// As many as the training data, for each member, as the method says.
    Full,
    /// An `n_members`-th of that, as the code behind the thesis does to save memory.
    Shrunk,
}

/// What stands under `with:` of an `ensemble` stage.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields, default)]
pub struct EnsembleParams {
    /// Policies.
    pub n_members: u64,
    /// Passes over the bootstrapped data; the last weights are kept.
    pub n_epochs: u64,
    /// Pairs a step, divided among the members (cut to a multiple of `n_members`). What does not fill a batch at the end
    /// of a pass is left out; fewer pairs than a batch are one batch.
    pub batch_size: u64,
    /// Adam's step size.
    pub learning_rate: f64,
    /// Share of the data that is held out.
    pub validation_fraction: f64,
    /// How data is held out.
    pub split: Split,
    /// How many pairs a member's bootstrap holds.
    pub bootstrap: Bootstrap,
    /// Where networks are computed; other devices give other bits, so it is part of the key.
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
    const ABOUT: &'static str = "trains an ensemble of policies on bootstraps of the demonstrations";
    const RENAMED: &'static [(&'static str, &'static str)] =
        &[("members", "n_members"), ("epochs", "n_epochs")];
    const REMOVED: &'static [(&'static str, &'static str)] = &[NO_PRECISION];
    type Params = EnsembleParams;

    fn check(params: &EnsembleParams, problems: &mut Problems) {
        problems.range("n_members", params.n_members, 2.., "at least 2: one policy has no disagreement");
        problems.positive("n_epochs", params.n_epochs);
        problems.positive_number("learning_rate", params.learning_rate);
        check_fraction(params.validation_fraction, problems);
        if params.batch_size < params.n_members {
            let message = format!(
                "`batch_size` is {}, expected at least one pair for each of the {} `n_members`",
                params.batch_size, params.n_members
            );
            problems.add("batch_size", message);
        }
    }

    fn ports(_: &EnsembleParams) -> Ports {
        Ports::new()
            .input("demonstrations", DEMONSTRATIONS, "what to imitate")
            .output("ensemble", ENSEMBLE, "safetensors", "the policies")
            .output("log", Artifact::TRAINING_LOG, "csv", "one row per epoch")
    }

    fn needs(params: &EnsembleParams) -> Needs {
        Needs::seconds(1.0 + 6.0 * params.n_epochs as f64)
    }
}
