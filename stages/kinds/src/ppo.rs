//! `ppo`: reinforcement learning on the environment's own reward.

use dril_envs::params::check_env;
use dril_envs::{ActionSpace, EnvConfig};
use dril_stage_api::{Artifact, Describe, Needs, Part, Ports, Problems};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use crate::artifacts::POLICY;
use crate::columns::{EPISODE_COLUMNS, UPDATE_COLUMNS};
use crate::default::defaults;
use crate::on_policy::{self, OnPolicyParams};
use crate::update::NO_PRECISION;
use crate::{Network, OnDivergence, PolicyFamily, UpdateParams};

/// Proximal policy optimisation (Schulman et al. 2017) on the environment's own reward.
#[derive(Clone, Copy, Debug)]
pub struct Ppo;

/// Parameters of a `ppo` stage (`with:`). Those of the annex's CarRacing experts are in `pipelines/thesis.yaml`.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct PpoParams {
    /// The environment.
    pub env: EnvConfig,
    /// Action distribution of the policy.
    pub policy: PolicyFamily,
    /// Network architecture. Default: `expert-cnn` for images, `mlp` for vectors.
    #[serde(default)]
    pub network: Option<Network>,
    /// Parameters shared with `dril`.
    #[serde(flatten)]
    pub on_policy: OnPolicyParams,
    /// How the policy is updated from a rollout.
    #[serde(flatten)]
    pub update: UpdateParams,
    /// Environment steps already trained when this stage starts, for a training that is split over several stages. The
    /// learning rate continues the schedule of one training of `total_timesteps`; the policy comes from the input
    /// `policy`. Adam's moments are reset and new episodes are started. A multiple of one rollout, `n_envs` × `n_steps`.
    #[serde(default)]
    pub from_step: u64,
    /// Staggers the first episodes: that of environment i of n is truncated after i/n of this many steps. At 0, as in the
    /// reference code, episodes of equal length start and end together: with a time limit of 1,000 steps and rollouts of
    /// 500, every second rollout contains only second halves of episodes.
    #[serde(default)]
    pub stagger: u64,
    /// Normalises vector observations by running mean and standard deviation and clips them to ±10, as the annex's
    /// LunarLander experts do. The statistics are stored with the policy. Images are not normalised.
    #[serde(default)]
    pub normalize_observations: bool,
    /// Initial standard deviation σ of a new `gaussian` policy, the same for each dimension. Only where the input `policy`
    /// is not connected.
    #[serde(default = "default::initial_deviation")]
    pub initial_deviation: f64,
    /// Gain of the orthogonal initialisation of a new policy's last layer: the mean of `gaussian`, α and β of `beta`. Only
    /// where the input `policy` is not connected. (The logits of `categorical` always use 0.01.)
    #[serde(default = "default::mean_gain")]
    pub mean_gain: f64,
    /// Initial mean action of a new `gaussian` policy (the bias of its last layer), one number per action dimension. Empty:
    /// zeros. Only where the input `policy` is not connected.
    #[serde(default)]
    pub initial_mean: Vec<f64>,
    /// What happens when an update diverges. By default the stage fails, since later stages should not build on an expert
    /// that is not fully trained.
    #[serde(default = "default::on_divergence")]
    pub on_divergence: OnDivergence,
}

defaults! {
    initial_deviation: f64 = 1.0;
    mean_gain: f64 = 1.0;
    on_divergence: OnDivergence = OnDivergence::Error;
}

impl PpoParams {
    /// Reports wrong settings of a new policy's initialisation.
    fn check_start(&self, problems: &mut Problems) {
        problems.positive_number("initial_deviation", self.initial_deviation);
        problems.positive_number("mean_gain", self.mean_gain);
        for (at, mean) in self.initial_mean.iter().enumerate().filter(|(_, mean)| !mean.is_finite()) {
            problems.add(
                &format!("initial_mean.{at}"),
                format!("`initial_mean` contains {mean}, expected finite numbers"),
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
                problems.add(
                    field,
                    format!("`{field}` is set, but applies to the policy {families} only; leave it out"),
                );
            } else if changed && self.from_step > 0 {
                let message = format!(
                    "`{field}` is set, but `from_step` is {}, so the policy comes from the input; leave it out",
                    self.from_step
                );
                problems.add(field, message);
            }
        }
        self.check_mean_length(problems);
    }

    /// Reports a number of initial means that differs from the action dimensions.
    fn check_mean_length(&self, problems: &mut Problems) {
        let seen = self.initial_mean.len();
        // Other spaces are looked up by starting a program; the stage checks them.
        if let Some((_, ActionSpace::Continuous { dims })) = self.env.known_spaces()
            && seen > 0
            && seen != dims
        {
            let message =
                format!("`initial_mean` has {seen} numbers, expected {dims}, one per action dimension");
            problems.add("initial_mean", message);
        }
    }
}

impl Describe for Ppo {
    const KIND: &'static str = "ppo";
    const REVISION: u32 = 3;
    const ABOUT: &'static str = "proximal policy optimisation on the environment's reward";
    const FLATTENED: &'static [Part] = on_policy::PARTS;
    const RENAMED: &'static [(&'static str, &'static str)] = on_policy::RENAMED;
    const REMOVED: &'static [(&'static str, &'static str)] = &[NO_PRECISION];
    type Params = PpoParams;

    fn check(params: &PpoParams, problems: &mut Problems) {
        check_env(&params.env, problems);
        params.update.check(params.on_policy.rollout(), problems);
        params.on_policy.check(params.from_step, problems);
        params.check_start(problems);
    }

    fn ports(params: &PpoParams) -> Ports {
        let ports = Ports::new();
        let ports = match params.from_step {
            0 => ports.optional("policy", POLICY, "the initial policy; a new one if not connected"),
            _ => ports.input("policy", POLICY, "the policy as trained up to `from_step`"),
        };
        ports
            .output("policy", POLICY, "safetensors", "the trained policy")
            .output("log", Artifact::TRAINING_LOG, "csv", "one row per update")
            .columns(&UPDATE_COLUMNS)
            .output("episodes", Artifact::TRAINING_LOG, "csv", "one row per training episode")
            .columns(&EPISODE_COLUMNS)
    }

    fn needs(params: &PpoParams) -> Needs {
        let steps = params.on_policy.to_step().saturating_sub(params.from_step) as f64;
        Needs::seconds(1.0 + steps / 3000.0 + steps * params.update.n_epochs as f64 / 2000.0)
    }
}
