//! `ppo`: trains an expert.

use crate::artifacts::POLICY;
use dril_envs::{ActionSpace, EnvConfig};
use dril_stage_api::{Artifact, Describe, Needs, Part, Ports, Problems};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use crate::default::defaults;
use crate::on_policy::{self, OnPolicyParams};
use crate::update::{NO_PRECISION, check_env};
use crate::{Algorithm, Network, OnDivergence, PolicyFamily, UpdateSettings};

/// Proximal policy optimisation (Schulman et al. 2017) on the environment's own reward.
#[derive(Clone, Copy, Debug)]
pub struct Ppo;

/// What stands under `with:` of a `ppo` stage. (The settings of the annex's CarRacing experts are in
/// `pipelines/thesis.yaml`.)
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct PpoParams {
    /// The environment.
    pub env: EnvConfig,
    /// The distribution over actions.
    pub policy: PolicyFamily,
    /// The layers; by default those that fit the observation: `expert-cnn` or `mlp`.
    #[serde(default)]
    pub network: Option<Network>,
    /// What `ppo` shares with `dril`.
    #[serde(flatten)]
    pub on_policy: OnPolicyParams,
    /// Where this stage takes up a training that several stages make one after the other: the steps that are done
    /// when it begins. The learning rate stands where it would stand in one training of `total_timesteps`; the agent
    /// comes from the input `policy`. Adam's moments and episodes under way start anew. A multiple of one rollout,
    /// `n_envs` × `n_steps`.
    #[serde(default)]
    pub from_step: u64,
    /// Lets the first episodes end one after the other: that of environment i of n is cut after i/n of so many steps, as
    /// by the time limit. At 0, as in the reference code, episodes of one length begin and end together: with a limit of
    /// 1,000 steps and rollouts of 500, every second rollout has only second halves of episodes in it.
    #[serde(default)]
    pub stagger: u64,
    /// Shows the agent each number of a vector by its distance from the running mean in running standard deviations,
    /// clipped to ±10, as the annex's LunarLander experts have it; the statistics are kept with the policy. Images are
    /// shown as they are.
    #[serde(default)]
    pub normalize_observations: bool,
    /// Standard deviation σ that a new `gaussian` agent begins with, the same for each dimension. No effect where an
    /// agent comes in.
    #[serde(default = "default::initial_deviation")]
    pub initial_deviation: f64,
    /// Gain of the orthogonal weights of a new agent's last layer: of the means of `gaussian`, of α and β of `beta`. No
    /// effect where an agent comes in. (The logits of `categorical` always begin with 0.01.)
    #[serde(default = "default::mean_gain")]
    pub mean_gain: f64,
    /// What the means of a new `gaussian` agent begin near: the bias of its last layer, a number for each dimension of
    /// the action; left empty, 0. No effect where an agent comes in.
    #[serde(default)]
    pub initial_mean: Vec<f64>,
    /// What happens when an update diverges. By default the stage fails: an expert that is not trained to its end is
    /// nothing to build on.
    #[serde(default = "default::on_divergence")]
    pub on_divergence: OnDivergence,
}

defaults! {
    initial_deviation: f64 = 1.0;
    mean_gain: f64 = 1.0;
    on_divergence: OnDivergence = OnDivergence::Error;
}

impl PpoParams {
    /// The settings of an update.
    pub fn update(&self) -> UpdateSettings {
        self.on_policy.update(Algorithm::Ppo)
    }

    /// Reports what is wrong with how a new agent begins.
    fn check_start(&self, problems: &mut Problems) {
        problems.positive_number("initial_deviation", self.initial_deviation);
        problems.positive_number("mean_gain", self.mean_gain);
        for (at, mean) in self.initial_mean.iter().enumerate().filter(|(_, mean)| !mean.is_finite()) {
            problems.add(
                &format!("initial_mean.{at}"),
                format!("`initial_mean` has {mean} in it, expected numbers"),
            );
        }
        let (gaussian, categorical) =
            (self.policy == PolicyFamily::Gaussian, self.policy == PolicyFamily::Categorical);
        for (field, changed, fits, families) in [
            (
                "initial_deviation",
                self.initial_deviation != default::initial_deviation(),
                gaussian,
                "`gaussian`",
            ),
            ("mean_gain", self.mean_gain != default::mean_gain(), !categorical, "`gaussian` or `beta`"),
            ("initial_mean", !self.initial_mean.is_empty(), gaussian, "`gaussian`"),
        ] {
            if changed && !fits {
                problems.add(field, format!("`{field}` is set, expected so for the policy {families} only"));
            } else if changed && self.from_step > 0 {
                let message = format!(
                    "`{field}` is set, expected its default: `from_step` is {}, so the agent comes from the input",
                    self.from_step
                );
                problems.add(field, message);
            }
        }
        self.check_mean_length(problems);
    }

    /// Reports a number of initial means that the actions do not have.
    fn check_mean_length(&self, problems: &mut Problems) {
        let actions = match &self.env {
            // Looking it up takes a Python; the stage checks it.
            EnvConfig::Gymnasium(_) => return,
            env => env.spaces().map(|(_, actions)| actions),
        };
        let seen = self.initial_mean.len();
        if let Ok(ActionSpace::Continuous { dims }) = actions
            && seen > 0
            && seen != dims
        {
            let message = format!("`initial_mean` has {seen} numbers, expected {dims}, as an action has");
            problems.add("initial_mean", message);
        }
    }
}

impl Describe for Ppo {
    const KIND: &'static str = "ppo";
    const REVISION: u32 = 3;
    const ABOUT: &'static str = "trains an agent by proximal policy optimisation on the environment's reward";
    const FLATTENED: &'static [Part] = on_policy::PARTS;
    const RENAMED: &'static [(&'static str, &'static str)] = on_policy::RENAMED;
    const REMOVED: &'static [(&'static str, &'static str)] = &[NO_PRECISION];
    type Params = PpoParams;

    fn check(params: &PpoParams, problems: &mut Problems) {
        check_env(&params.env, problems);
        params.on_policy.check(params.from_step, problems);
        params.check_start(problems);
    }

    fn ports(params: &PpoParams) -> Ports {
        let ports = Ports::new();
        let ports = match params.from_step {
            0 => ports.optional("policy", POLICY, "the agent to begin with; left out: a new one"),
            _ => ports.input("policy", POLICY, "the agent as it stood at `from_step`"),
        };
        ports
            .output("policy", POLICY, "safetensors", "the trained agent")
            .output("log", Artifact::TRAINING_LOG, "csv", "one row per update")
            .output("episodes", Artifact::TRAINING_LOG, "csv", "one row per episode of the training")
    }

    fn needs(params: &PpoParams) -> Needs {
        let steps = params.on_policy.to_step().saturating_sub(params.from_step) as f64;
        Needs::seconds(1.0 + steps / 3000.0 + steps * params.on_policy.n_epochs as f64 / 2000.0)
    }
}
