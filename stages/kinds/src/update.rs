//! Parameters of one update of the policy, which every on-policy kind has.

use dril_stage_api::Problems;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

/// How a policy is updated from a rollout (Schulman et al. 2017); flattened into the parameters of `ppo` and `dril`.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(default)]
pub struct UpdateParams {
    /// Number of epochs: passes over each rollout.
    pub n_epochs: u64,
    /// Number of minibatches per epoch (their number, not their size). A minibatch has the size of the
    /// rollout divided by it, rounded down. If enough samples remain, they form further minibatches; fewer are dropped.
    pub n_minibatches: u64,
    /// Clipping range ε of the surrogate objective and of the value loss.
    pub clip_range: f64,
    /// Entropy coefficient: weight of the entropy bonus in the loss.
    pub ent_coef: f64,
    /// Value function coefficient: weight of the value loss.
    pub vf_coef: f64,
    /// Maximum global norm of the gradients; larger ones are scaled down.
    pub max_grad_norm: f64,
    /// Discount factor γ.
    pub gamma: f64,
    /// λ of generalised advantage estimation (Schulman et al. 2016).
    pub gae_lambda: f64,
}

impl Default for UpdateParams {
    fn default() -> Self {
        Self {
            n_epochs: 10,
            n_minibatches: 32,
            clip_range: 0.2,
            ent_coef: 0.0,
            vf_coef: 0.5,
            max_grad_norm: 0.5,
            gamma: 0.99,
            gae_lambda: 0.95,
        }
    }
}

impl UpdateParams {
    /// Reports values out of range, for rollouts of `samples` environment steps.
    pub(crate) fn check(&self, samples: u64, problems: &mut Problems) {
        problems.positive("n_minibatches", self.n_minibatches);
        let count = self.n_minibatches;
        if samples > 0 && count > samples {
            let message = format!(
                "`n_minibatches` is {count}, expected at most the {samples} samples of a rollout (`n_envs` × `n_steps`)"
            );
            problems.add("n_minibatches", message);
        }
        problems.positive("n_epochs", self.n_epochs);
        problems.positive_number("clip_range", self.clip_range);
        problems.range("ent_coef", self.ent_coef, 0.0..=f64::MAX, "at least 0");
        problems.range("vf_coef", self.vf_coef, 0.0..=f64::MAX, "at least 0");
        problems.positive_number("max_grad_norm", self.max_grad_norm);
        problems.fraction("gamma", self.gamma);
        problems.fraction("gae_lambda", self.gae_lambda);
    }
}

/// What replaces the former parameter `precision`; for [`dril_stage_api::Describe::REMOVED`].
pub(crate) const NO_PRECISION: (&str, &str) =
    ("precision", "leave it out: everything is computed in single precision (32 bits)");
