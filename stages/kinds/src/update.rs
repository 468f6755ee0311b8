//! The settings of one update, and the check of an environment that several kinds share.

use dril_stage_api::Problems;

use crate::Algorithm;

/// One PPO update (Schulman et al. 2017): what happens to a rollout.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct UpdateSettings {
    /// What an update is.
    pub algorithm: Algorithm,
    /// Passes over the rollout.
    pub n_epochs: u64,
    /// Minibatches a pass; the rollout is cut into this many, a remainder is dropped.
    pub n_minibatches: u64,
    /// ε of the clipped surrogate and of the clipped value loss.
    pub clip_range: f64,
    /// Weight of the entropy bonus.
    pub ent_coef: f64,
    /// Weight of the value loss.
    pub vf_coef: f64,
    /// Global norm to which gradients are clipped.
    pub max_grad_norm: f64,
    /// Discount.
    pub gamma: f64,
    /// λ of generalised advantage estimation (Schulman et al. 2016).
    pub gae_lambda: f64,
}

/// Reports what is wrong with an environment.
pub(crate) fn check_env(env: &dril_envs::EnvConfig, problems: &mut Problems) {
    for (path, message) in env.check() {
        problems.add(&format!("env.{path}"), message);
    }
}

/// Why there is no `precision` any more; for [`dril_stage_api::Describe::REMOVED`].
pub(crate) const NO_PRECISION: (&str, &str) = ("precision", "leave it out: all is computed with 32 bits");
