//! `collect`: records demonstrations of an expert.

use dril_envs::params::{check_attempts, check_env, check_seeds};
use dril_envs::{DEMONSTRATIONS, EnvConfig};
use dril_stage_api::{Describe, Needs, Ports, Problems};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use crate::Mode;
use crate::artifacts::POLICY;
use crate::default::defaults;
use crate::evaluate::RENAMED;

/// Records episodes of a policy and keeps the first that score above a threshold.
#[derive(Clone, Copy, Debug)]
pub struct Collect;

/// Parameters of a `collect` stage (`with:`).
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct CollectParams {
    /// The environment.
    pub env: EnvConfig,
    /// How the expert chooses its actions. The collector in the thesis's code is deterministic, but a deterministic
    /// Gaussian expert scores 370 on average and rarely more than 900; how the thesis's files were recorded is unknown.
    #[serde(default = "default::mode")]
    pub mode: Mode,
    /// Number of episodes to keep.
    #[serde(default = "default::episodes")]
    pub episodes: u64,
    /// Minimum score: only episodes that score more are kept. Thesis: 900 (its collector: 920).
    #[serde(default = "default::above")]
    pub above: f64,
    /// Maximum number of episodes to play.
    #[serde(default = "default::max_attempts")]
    pub max_attempts: u64,
    /// Attempt i uses the environment seed `first_seed` + i, which determines its track, terrain or level.
    pub first_seed: u64,
}

defaults! {
    mode: Mode = Mode::Stochastic;
    episodes: u64 = 20;
    above: f64 = 900.0;
    max_attempts: u64 = 500;
}

impl Describe for Collect {
    const KIND: &'static str = "collect";
    const REVISION: u32 = 3;
    const ABOUT: &'static str = "records episodes of a policy that score above a threshold";
    const RENAMED: &'static [(&'static str, &'static str)] = RENAMED;
    type Params = CollectParams;

    fn check(params: &CollectParams, problems: &mut Problems) {
        check_env(&params.env, problems);
        check_attempts(params.episodes, params.max_attempts, problems);
        check_seeds(params.first_seed, params.max_attempts, problems);
    }

    fn ports(_: &CollectParams) -> Ports {
        Ports::new().input("policy", POLICY, "the expert policy").output(
            "demonstrations",
            DEMONSTRATIONS,
            "demos",
            "the kept episodes, with actions as the policy chose them",
        )
    }

    fn needs(params: &CollectParams) -> Needs {
        Needs::seconds(1.0 + 0.6 * params.episodes as f64)
    }
}
