//! `trace`: one episode step by step, played by an agent or walked through as it was recorded.

use dril_envs::params::{check_env, check_seeds};
use dril_envs::{DEMONSTRATIONS, EnvConfig};
use dril_stage_api::{Artifact, Describe, Needs, Ports, Problems};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use crate::artifacts::{ENSEMBLE, POLICY};
use crate::default::defaults;
use crate::{Mode, RewardScheme, Thresholds};

/// Writes what happens at each step of a few episodes.
#[derive(Clone, Copy, Debug)]
pub struct Trace;

/// Parameters of a `trace` stage (`with:`).
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct TraceParams {
    /// The environment in which the agent at the input `policy` plays. Left out: no agent plays, and the episodes of the
    /// input `demonstrations` are traced.
    #[serde(default)]
    pub env: Option<EnvConfig>,
    /// How the agent acts.
    #[serde(default = "default::mode")]
    pub mode: Mode,
    /// Probability, drawn at each step, of acting by the mean although a draw was asked for. DRIL trains with 0.1.
    #[serde(default)]
    pub mean_action_probability: f64,
    /// The agent plays episode i with the seed `first_seed` + i.
    #[serde(default)]
    pub first_seed: u64,
    /// Number of episodes, from the first on.
    #[serde(default = "default::episodes")]
    pub episodes: u64,
    /// Number of steps, over all episodes, after which the trace ends. Left out: all steps are traced.
    #[serde(default)]
    pub steps: Option<u64>,
    /// Whether the actions are played again, from the seed of their episode: rewards, scores, poses and images come from
    /// this. Without it their columns are empty.
    #[serde(default = "default::replay")]
    pub replay: bool,
    /// Whether the first episode is also drawn: as a small GIF, and as six images side by side.
    #[serde(default)]
    pub video: bool,
    /// With an ensemble: the quantile of its disagreement on the demonstrations that is the limit, as in `dril`.
    #[serde(default = "default::quantile")]
    pub quantile: f64,
    /// With an ensemble: the reward for disagreement within and above the limit, as in `dril`.
    #[serde(default)]
    pub reward: RewardScheme,
    /// With an ensemble, for discrete actions: whose limit applies to an action, as in `dril`.
    #[serde(default)]
    pub thresholds: Thresholds,
}

defaults! {
    mode: Mode = Mode::Stochastic;
    episodes: u64 = 1;
    replay: bool = true;
    quantile: f64 = 0.98;
}

impl Describe for Trace {
    const KIND: &'static str = "trace";
    const REVISION: u32 = 1;
    const ABOUT: &'static str = "writes what happens at each step of an episode, and draws it";
    type Params = TraceParams;

    fn check(params: &TraceParams, problems: &mut Problems) {
        if let Some(env) = &params.env {
            check_env(env, problems);
        }
        problems.positive("episodes", params.episodes);
        if let Some(steps) = params.steps {
            problems.positive("steps", steps);
        }
        problems.fraction("mean_action_probability", params.mean_action_probability);
        problems.fraction("quantile", params.quantile);
        check_seeds(params.first_seed, params.episodes, problems);
        if params.video && !params.replay {
            problems.add("video", "`video` is true, but `replay` is false: there is nothing to draw");
        }
    }

    fn ports(params: &TraceParams) -> Ports {
        let (recording, ports) = ("the recording", Ports::new());
        let ports = match params.env {
            Some(_) => ports.input("policy", POLICY, "the agent").optional(
                "demonstrations",
                DEMONSTRATIONS,
                "with an ensemble: what its limit is taken from",
            ),
            None => ports.input("demonstrations", DEMONSTRATIONS, recording),
        };
        let ports = ports
            .optional("ensemble", ENSEMBLE, "policies whose disagreement on each action is written")
            .output(
                "steps",
                Artifact::TRAINING_LOG,
                "csv",
                "one row per step: reward, score, action, pose, and the ensemble's cost, limit and signal",
            )
            .output("map", Artifact::FILE, "csv", "the lines of the first episode's track or ground");
        if !params.video {
            return ports;
        }
        ports
            .output("strip", Artifact::FIGURE, "png", "six moments of the first episode, side by side")
            .output("video", Artifact::FIGURE, "gif", "the first episode, ten images a second")
    }

    fn needs(params: &TraceParams) -> Needs {
        Needs::seconds(1.0 + params.episodes as f64)
    }
}
