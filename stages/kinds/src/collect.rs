//! `collect`: records an expert's good episodes.

use dril_envs::EnvConfig;
use dril_stage_api::{Artifact, Describe, Needs, Ports, Problems};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use crate::evaluate::check_tracks;
use crate::update::check_env;
use crate::{Mode, default};

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
    #[serde(default = "stochastic")]
    pub mode: Mode,
    /// Episodes to keep.
    #[serde(default = "default::int::<20>")]
    pub episodes: u64,
    /// Only episodes with a score above this are kept. Thesis: 900 (its collector: 920).
    #[serde(default = "default::ratio::<900, 1>")]
    pub above: f64,
    /// Episodes to play at most.
    #[serde(default = "default::int::<500>")]
    pub max_attempts: u64,
    /// Attempt i is played on the track of seed `first_track_seed` + i.
    pub first_track_seed: u64,
}

fn stochastic() -> Mode {
    Mode::Stochastic
}

impl Describe for Collect {
    const KIND: &'static str = "collect";
    const REVISION: u32 = 2;
    const ABOUT: &'static str = "records an agent's episodes that score above a threshold";
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
        check_tracks(params.first_track_seed, params.max_attempts, problems);
    }

    fn ports(_: &CollectParams) -> Ports {
        Ports::new().input("policy", Artifact::Policy, "the expert").output(
            "demonstrations",
            Artifact::Demonstrations,
            "demos",
            "the kept episodes, actions as the policy gave them",
        )
    }

    fn needs(params: &CollectParams) -> Needs {
        Needs::seconds(1.0 + 0.6 * params.episodes as f64)
    }
}
