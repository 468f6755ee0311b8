//! `collect`: records an expert's good episodes.

use crate::artifacts::POLICY;
use dril_envs::DEMONSTRATIONS;
use dril_envs::EnvConfig;
use dril_stage_api::{Describe, Needs, Ports, Problems};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use crate::Mode;
use crate::default::defaults;
use crate::evaluate::{RENAMED, check_seeds};
use crate::update::check_env;

/// Records episodes of an agent and keeps the first ones that score above a threshold.
#[derive(Clone, Copy, Debug)]
pub struct Collect;

/// What stands under `with:` of a `collect` stage.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct CollectParams {
    /// The environment.
    pub env: EnvConfig,
    /// How the expert acts. The committed collector acts deterministically, but a deterministic Gaussian expert averages
    /// 370 and hardly ever passes 900: what made the thesis's files is open.
    #[serde(default = "default::mode")]
    pub mode: Mode,
    /// Episodes to keep.
    #[serde(default = "default::episodes")]
    pub episodes: u64,
    /// Only episodes with a score above this are kept. Thesis: 900 (its collector: 920).
    #[serde(default = "default::above")]
    pub above: f64,
    /// Episodes to play at most.
    #[serde(default = "default::max_attempts")]
    pub max_attempts: u64,
    /// Attempt i is played with the seed `first_seed` + i, which names its track, ground or level.
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
    const ABOUT: &'static str = "records an agent's episodes that score above a threshold";
    const RENAMED: &'static [(&'static str, &'static str)] = RENAMED;
    type Params = CollectParams;

    fn check(params: &CollectParams, problems: &mut Problems) {
        check_env(&params.env, problems);
        problems.positive("episodes", params.episodes);
        if params.max_attempts < params.episodes {
            let message = format!(
                "`max_attempts` is {}, expected at least the {} `episodes` to keep",
                params.max_attempts, params.episodes
            );
            problems.add("max_attempts", message);
        }
        check_seeds(params.first_seed, params.max_attempts, problems);
    }

    fn ports(_: &CollectParams) -> Ports {
        Ports::new().input("policy", POLICY, "the expert").output(
            "demonstrations",
            DEMONSTRATIONS,
            "demos",
            "the kept episodes, actions as the policy gave them",
        )
    }

    fn needs(params: &CollectParams) -> Needs {
        Needs::seconds(1.0 + 0.6 * params.episodes as f64)
    }
}
