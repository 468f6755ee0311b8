//! `evaluate`: scores an agent on a fixed list of seeds.

use crate::artifacts::POLICY;
use dril_envs::EnvConfig;
use dril_stage_api::{Artifact, Describe, Needs, Ports, Problems};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use crate::Mode;
use crate::default::defaults;
use crate::update::check_env;

/// Plays one episode with each seed of a fixed list and writes the scores.
#[derive(Clone, Copy, Debug)]
pub struct Evaluate;

/// What stands under `with:` of an `evaluate` stage.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct EvaluateParams {
    /// The environment.
    pub env: EnvConfig,
    /// How the agent acts.
    pub mode: Mode,
    /// Episodes, each with a seed of its own.
    #[serde(default = "default::episodes")]
    pub episodes: u64,
    /// Episode i is played with the seed `first_seed` + i, which names its track, ground or level: the same list for
    /// every agent.
    pub first_seed: u64,
    /// Probability, drawn at each step, of acting by the mean although a draw was asked for. The reference's
    /// "stochastic" evaluation has 0.1.
    #[serde(default)]
    pub mean_action_probability: f64,
    /// Which episodes count.
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
    /// Those of the list, however long they last: every agent plays the same seeds.
    #[default]
    Listed,
    /// The first that finish, where eight environments go through the seeds side by side without end, as the reference
    /// does it: crashes and quick laps come in before long episodes, and two agents are seen on different seeds.
    FirstFinished,
}

impl Describe for Evaluate {
    const KIND: &'static str = "evaluate";
    const REVISION: u32 = 3;
    const ABOUT: &'static str = "plays one episode with each seed of a fixed list and writes the scores";
    const RENAMED: &'static [(&'static str, &'static str)] = RENAMED;
    type Params = EvaluateParams;

    fn check(params: &EvaluateParams, problems: &mut Problems) {
        check_env(&params.env, problems);
        problems.positive("episodes", params.episodes);
        problems.fraction("mean_action_probability", params.mean_action_probability);
        check_seeds(params.first_seed, params.episodes, problems);
    }

    fn ports(_: &EvaluateParams) -> Ports {
        Ports::new().input("policy", POLICY, "the agent").output(
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

/// Reports a list of seeds that runs over the end of the numbers.
pub(crate) fn check_seeds(first: u64, count: u64, problems: &mut Problems) {
    if first.checked_add(count).is_none() {
        problems.add(
            "first_seed",
            format!("`first_seed` is {first}: {count} seeds from there do not fit 64 bits"),
        );
    }
}
