//! `evaluate`: scores a policy on a fixed list of seeds.

use dril_envs::EnvConfig;
use dril_envs::params::{check_env, check_seeds};
use dril_stage_api::{Artifact, Describe, Needs, Ports, Problems};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use crate::Mode;
use crate::artifacts::POLICY;
use crate::default::defaults;

/// Plays one episode for each seed of a fixed list and writes the scores.
#[derive(Clone, Copy, Debug)]
pub struct Evaluate;

/// Parameters of an `evaluate` stage (`with:`).
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct EvaluateParams {
    /// The environment.
    pub env: EnvConfig,
    /// How the policy chooses its actions.
    pub mode: Mode,
    /// Number of episodes, each with its own seed.
    #[serde(default = "default::episodes")]
    pub episodes: u64,
    /// Episode i uses the environment seed `first_seed` + i, which determines its track, terrain or level. All policies are
    /// evaluated on the same seeds.
    pub first_seed: u64,
    /// Probability per step of using the mean action in stochastic mode. The reference code evaluates "stochastic"
    /// policies with 0.1.
    #[serde(default)]
    pub mean_action_probability: f64,
    /// Which episodes are counted.
    #[serde(default)]
    pub counted: Counted,
}

defaults! {
    episodes: u64 = 100;
}

/// Which episodes an evaluation counts.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "kebab-case")]
pub enum Counted {
    /// Those of the list of seeds, however long they last: every policy is evaluated on the same seeds.
    #[default]
    Listed,
    /// The first to finish of eight environments that run through the seeds in parallel, as in the reference code. Short
    /// episodes (crashes, fast laps) are over-represented, and two policies are evaluated on different seeds.
    FirstFinished,
}

impl Describe for Evaluate {
    const KIND: &'static str = "evaluate";
    const REVISION: u32 = 3;
    const ABOUT: &'static str = "plays one episode for each seed of a fixed list and writes the scores";
    const RENAMED: &'static [(&'static str, &'static str)] = RENAMED;
    type Params = EvaluateParams;

    fn check(params: &EvaluateParams, problems: &mut Problems) {
        check_env(&params.env, problems);
        problems.positive("episodes", params.episodes);
        problems.fraction("mean_action_probability", params.mean_action_probability);
        check_seeds(params.first_seed, params.episodes, problems);
    }

    fn ports(_: &EvaluateParams) -> Ports {
        Ports::new().input("policy", POLICY, "the policy").output(
            "scores",
            Artifact::SCORES,
            "csv",
            "one row per episode: seed, score, steps, outcome",
        )
    }

    fn needs(params: &EvaluateParams) -> Needs {
        Needs::seconds(1.0 + 0.3 * params.episodes as f64)
    }
}

/// For [`Describe::RENAMED`].
pub(crate) const RENAMED: &[(&str, &str)] = &[("first_track_seed", "first_seed")];
