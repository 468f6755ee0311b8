//! `probe`: what an agent would do at one recorded observation.

use dril_envs::DEMONSTRATIONS;
use dril_stage_api::{Artifact, Describe, Needs, Ports, Problems};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use crate::artifacts::POLICY;
use crate::default::defaults;
use crate::{Network, PolicyFamily};

/// Writes the distribution over actions that an agent has for one recorded observation, and draws from it.
#[derive(Clone, Copy, Debug)]
pub struct Probe;

/// Parameters of a `probe` stage (`with:`).
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct ProbeParams {
    /// The family of a new agent with random weights. Left out: the agent at the input `policy` is looked at.
    #[serde(default)]
    pub fresh: Option<PolicyFamily>,
    /// The layers of a new agent. Left out: `dril-cnn` for images and `mlp` for vectors, as in `bc`.
    #[serde(default)]
    pub network: Option<Network>,
    /// The episode of the recording, from 0.
    #[serde(default)]
    pub episode: u64,
    /// The step of that episode, from 0.
    #[serde(default)]
    pub step: u64,
    /// Number of actions to draw.
    #[serde(default = "default::draws")]
    pub draws: u64,
    /// Whether the observation is drawn. A recorded image is shown as the agent sees it, with those before it; where
    /// observations are vectors, the recorded actions are played again up to the step, and the environment is drawn.
    #[serde(default = "default::image")]
    pub image: bool,
}

defaults! {
    draws: u64 = 2000;
    image: bool = true;
}

impl Describe for Probe {
    const KIND: &'static str = "probe";
    const REVISION: u32 = 1;
    const ABOUT: &'static str = "writes the distribution over actions that an agent has for one observation";
    type Params = ProbeParams;

    fn check(params: &ProbeParams, problems: &mut Problems) {
        problems.positive("draws", params.draws);
        if params.network.is_some() && params.fresh.is_none() {
            problems.add("network", "`network` is for new agents; it needs `fresh`");
        }
    }

    fn ports(params: &ProbeParams) -> Ports {
        let ports = match params.fresh {
            None => Ports::new().input("policy", POLICY, "the agent"),
            Some(_) => Ports::new(),
        };
        let ports = ports
            .input("demonstrations", DEMONSTRATIONS, "the recording")
            .output(
                "distribution",
                Artifact::TABLE,
                "csv",
                "one row per dimension of an action, or choice: its parameters, and what the expert did",
            )
            .output(
                "draws",
                Artifact::FILE,
                "csv",
                "one row per drawn action; the expert's action stands in each",
            );
        match params.image {
            true => ports.output("image", Artifact::FIGURE, "png", "the observation"),
            false => ports,
        }
    }

    fn needs(params: &ProbeParams) -> Needs {
        Needs::seconds(1.0 + params.draws as f64 / 100_000.0)
    }
}
