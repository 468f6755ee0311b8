//! `ppo`: trains an expert.

use dril_envs::EnvConfig;
use dril_stage_api::{Artifact, Describe, Needs, Ports, Problems};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use crate::update::{check_env, check_run};
use crate::{Algorithm, Network, PolicyFamily, Precision, UpdateSettings, default};

/// Proximal policy optimisation (Schulman et al. 2017) on the environment's own reward.
#[derive(Clone, Copy, Debug)]
pub struct Ppo;

/// What stands under `with:` of a `ppo` stage. Defaults are those of the annex's CarRacing experts.
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
    /// Environment steps in all, over all `envs`; a remainder below one rollout is not run.
    #[serde(default = "default::int::<5_000_000>")]
    pub total_steps: u64,
    /// Where this stage takes up a training that several stages make one after the other: the steps that are done
    /// when it begins. The learning rate stands where it would stand in one training of `total_steps`; the agent comes
    /// from the input `policy`. Moments of Adam and episodes under way begin anew. A multiple of `envs` ×
    /// `rollout_steps`.
    #[serde(default, skip_serializing_if = "default::is")]
    #[schemars(extend("default" = 0))]
    pub from_step: u64,
    /// Where this stage ends such a training; by default with `total_steps`.
    #[serde(default, skip_serializing_if = "default::is")]
    pub to_step: Option<u64>,
    /// Environments side by side.
    #[serde(default = "default::int::<8>")]
    pub envs: u64,
    /// Steps of each environment between updates.
    #[serde(default = "default::int::<500>")]
    pub rollout_steps: u64,
    /// Lets the first episodes end one after the other: that of environment i of n is cut after i/n of so many steps, as
    /// by the time limit. At 0, as in the reference code, episodes of one length begin and end together: with a limit of
    /// 1,000 steps and rollouts of 500, every second rollout has only second halves of episodes in it.
    #[serde(default, skip_serializing_if = "default::is")]
    #[schemars(extend("default" = 0))]
    pub stagger: u64,
    /// Passes over each rollout. The annex's table says 10; the code that made its agents has 4.
    #[serde(default = "default::int::<4>")]
    pub epochs: u64,
    /// Minibatches a pass (their number, not their size).
    #[serde(default = "default::int::<32>")]
    pub minibatches: u64,
    /// Adam's step size.
    #[serde(default = "default::ratio::<25, 100_000>")]
    pub learning_rate: f64,
    /// Lowers the learning rate linearly to 0 over the run.
    #[serde(default = "default::yes")]
    pub anneal_learning_rate: bool,
    /// ε of the clipped surrogate and of the clipped value loss.
    #[serde(default = "default::ratio::<1, 10>")]
    pub clip_range: f64,
    /// Weight of the entropy bonus.
    #[serde(default = "default::ratio::<1, 100>")]
    pub entropy_coef: f64,
    /// Weight of the value loss.
    #[serde(default = "default::ratio::<1, 2>")]
    pub value_coef: f64,
    /// Global norm to which gradients are clipped.
    #[serde(default = "default::ratio::<1, 2>")]
    pub max_grad_norm: f64,
    /// Discount.
    #[serde(default = "default::ratio::<99, 100>")]
    pub gamma: f64,
    /// λ of generalised advantage estimation.
    #[serde(default = "default::ratio::<95, 100>")]
    pub gae_lambda: f64,
    /// ε of Adam.
    #[serde(default = "default::ratio::<1, 100_000>")]
    pub adam_epsilon: f64,
    /// Values the state after a time limit instead of taking the limit for a real end. The reference code of the
    /// imitators takes it for an end (`false`).
    #[serde(default = "default::yes")]
    pub bootstrap_time_limits: bool,
    /// Probability, drawn once for all environments at each step, of acting by the mean although a draw was asked for.
    /// The experts' code has none; the imitators' has 0.1.
    #[serde(default)]
    pub mean_action_probability: f64,
    /// Shows the agent each number of a vector by its distance from the running mean in running standard deviations,
    /// clipped to ±10, as the annex's LunarLander experts have it; the statistics are kept with the policy. Pictures
    /// are shown as they are.
    #[serde(default, skip_serializing_if = "default::is")]
    #[schemars(extend("default" = false))]
    pub normalize_observations: bool,
    /// Divides rewards by the running deviation of their discounted sum and clips them to ±10, as the annex's
    /// LunarLander experts have it. Scores stay those of the environment.
    #[serde(default, skip_serializing_if = "default::is")]
    #[schemars(extend("default" = false))]
    pub normalize_reward: bool,
    /// The numbers to compute with.
    #[serde(default, skip_serializing_if = "default::is")]
    #[schemars(extend("default" = "fp32"))]
    pub precision: Precision,
}

impl PpoParams {
    /// The step at which this stage ends.
    pub fn to_step(&self) -> u64 {
        self.to_step.unwrap_or(self.total_steps)
    }

    /// Reports a leg that is empty, too long, or does not begin and end between updates.
    fn check_leg(&self, problems: &mut Problems) {
        let update = self.envs.saturating_mul(self.rollout_steps).max(1);
        for (field, value) in [("from_step", Some(self.from_step)), ("to_step", self.to_step)] {
            if let Some(value) = value.filter(|value| value % update != 0) {
                let message = format!(
                    "`{field}` is {value}, expected a multiple of one rollout: {update} (`envs` × `rollout_steps`)"
                );
                problems.add(field, message);
            }
        }
        let (from, to, total) = (self.from_step, self.to_step(), self.total_steps);
        if to > total {
            problems.add("to_step", format!("`to_step` is {to}, expected at most `total_steps`: {total}"));
        } else if from.saturating_add(update) > to {
            let message =
                format!("`from_step` is {from}, expected at least one rollout ({update}) less than {to}");
            problems.add("from_step", message);
        }
    }

    /// The settings of an update.
    pub fn update(&self) -> UpdateSettings {
        UpdateSettings {
            algorithm: Algorithm::Ppo,
            epochs: self.epochs,
            minibatches: self.minibatches,
            clip_range: self.clip_range,
            entropy_coef: self.entropy_coef,
            value_coef: self.value_coef,
            max_grad_norm: self.max_grad_norm,
            gamma: self.gamma,
            gae_lambda: self.gae_lambda,
        }
    }
}

impl Describe for Ppo {
    const KIND: &'static str = "ppo";
    const REVISION: u32 = 2;
    const ABOUT: &'static str = "trains an agent by proximal policy optimisation on the environment's reward";
    type Params = PpoParams;

    fn check(params: &PpoParams, problems: &mut Problems) {
        check_env(&params.env, problems);
        check_run(params.total_steps, params.envs, params.rollout_steps, problems);
        params.check_leg(problems);
        params.update().check(params.envs, params.rollout_steps, problems);
        problems.positive_number("learning_rate", params.learning_rate);
        problems.positive_number("adam_epsilon", params.adam_epsilon);
        problems.fraction("mean_action_probability", params.mean_action_probability);
    }

    fn ports(params: &PpoParams) -> Ports {
        let ports = Ports::new();
        let ports = match params.from_step {
            0 => ports.optional("policy", Artifact::Policy, "the agent to begin with; left out: a new one"),
            _ => ports.input("policy", Artifact::Policy, "the agent as it stood at `from_step`"),
        };
        ports.output("policy", Artifact::Policy, "safetensors", "the trained agent").output(
            "log",
            Artifact::TrainingLog,
            "csv",
            "one row per update",
        )
    }

    fn needs(params: &PpoParams) -> Needs {
        let steps = params.to_step().saturating_sub(params.from_step) as f64;
        Needs::seconds(1.0 + steps / 3000.0 + steps * params.epochs as f64 / 2000.0)
    }
}
