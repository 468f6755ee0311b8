//! `ensemble`: the policies whose disagreement DRIL punishes.

use dril_stage_api::{Artifact, Describe, Needs, Ports, Problems};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use crate::bc::{check_fraction, pairs};
use crate::{Precision, Split, default};

/// Trains an ensemble of policies, each on its own bootstrap of the demonstrations (Brantley et al. 2020).
#[derive(Clone, Copy, Debug)]
pub struct Ensemble;

/// How many pairs a member's bootstrap holds.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "kebab-case")]
pub enum Bootstrap {
    /// As many as the training data, for each member, as the method says.
    Full,
    /// A `members`-th of that, as the code behind the thesis does to save memory.
    Shrunk,
}

/// What stands under `with:` of an `ensemble` stage.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct EnsembleParams {
    /// Policies.
    #[serde(default = "default::int::<5>")]
    pub members: u64,
    /// Passes over the bootstrapped data; the last weights are kept.
    #[serde(default = "default::int::<2001>")]
    pub epochs: u64,
    /// Pairs a step, divided among the members (cut to a multiple of `members`). What does not fill a batch at the end of
    /// a pass is left out; fewer pairs than a batch are one batch.
    #[serde(default = "default::int::<100>")]
    pub batch_size: u64,
    /// Adam's step size.
    #[serde(default = "default::ratio::<25, 100_000>")]
    pub learning_rate: f64,
    /// Share of the data that is held out.
    #[serde(default = "default::ratio::<1, 5>")]
    pub validation_fraction: f64,
    /// How data is held out.
    #[serde(default = "pairs")]
    pub split: Split,
    /// How many pairs a member's bootstrap holds.
    #[serde(default = "shrunk")]
    pub bootstrap: Bootstrap,
    /// The numbers to compute with. What the members answer to DRIL is always computed with 32 bits.
    #[serde(default, skip_serializing_if = "default::is")]
    #[schemars(extend("default" = "fp32"))]
    pub precision: Precision,
}

fn shrunk() -> Bootstrap {
    Bootstrap::Shrunk
}

impl Describe for Ensemble {
    const KIND: &'static str = "ensemble";
    const REVISION: u32 = 2;
    const ABOUT: &'static str = "trains an ensemble of policies on bootstraps of the demonstrations";
    type Params = EnsembleParams;

    fn check(params: &EnsembleParams, problems: &mut Problems) {
        problems.range("members", params.members, 2.., "at least 2: one policy has no disagreement");
        problems.positive("epochs", params.epochs);
        problems.positive_number("learning_rate", params.learning_rate);
        check_fraction(params.validation_fraction, problems);
        if params.batch_size < params.members {
            let message = format!(
                "`batch_size` is {}, expected at least one pair for each of the {} `members`",
                params.batch_size, params.members
            );
            problems.add("batch_size", message);
        }
    }

    fn ports(_: &EnsembleParams) -> Ports {
        Ports::new()
            .input("demonstrations", Artifact::Demonstrations, "what to imitate")
            .output("ensemble", Artifact::Ensemble, "safetensors", "the policies")
            .output("log", Artifact::TrainingLog, "csv", "one row per epoch")
    }

    fn needs(params: &EnsembleParams) -> Needs {
        Needs::seconds(1.0 + 6.0 * params.epochs as f64)
    }
}
