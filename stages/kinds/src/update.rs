//! The settings of a PPO update, which `ppo` and `dril` share.

use dril_stage_api::Problems;

use crate::Algorithm;

/// One PPO update (Schulman et al. 2017): what happens to a rollout.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct UpdateSettings {
    /// What an update is.
    pub algorithm: Algorithm,
    /// Passes over the rollout.
    pub epochs: u64,
    /// Minibatches a pass; the rollout is cut into this many, a remainder is dropped.
    pub minibatches: u64,
    /// ε of the clipped surrogate and of the clipped value loss.
    pub clip_range: f64,
    /// Weight of the entropy bonus.
    pub entropy_coef: f64,
    /// Weight of the value loss.
    pub value_coef: f64,
    /// Global norm to which gradients are clipped.
    pub max_grad_norm: f64,
    /// Discount.
    pub gamma: f64,
    /// λ of generalised advantage estimation (Schulman et al. 2016).
    pub gae_lambda: f64,
}

impl UpdateSettings {
    /// Reports what is out of range, for a rollout of `envs` × `rollout_steps`.
    pub(crate) fn check(&self, envs: u64, rollout_steps: u64, problems: &mut Problems) {
        problems.positive("epochs", self.epochs);
        problems.positive("minibatches", self.minibatches);
        problems.positive_number("clip_range", self.clip_range);
        problems.range("entropy_coef", self.entropy_coef, 0.0..=f64::MAX, "at least 0");
        problems.range("value_coef", self.value_coef, 0.0..=f64::MAX, "at least 0");
        problems.positive_number("max_grad_norm", self.max_grad_norm);
        problems.fraction("gamma", self.gamma);
        problems.fraction("gae_lambda", self.gae_lambda);
        let samples = envs.saturating_mul(rollout_steps);
        if samples > 0 && self.minibatches > samples {
            let message = format!(
                "`minibatches` is {}, expected at most the {samples} samples of a rollout (`envs` × `rollout_steps`)",
                self.minibatches
            );
            problems.add("minibatches", message);
        }
    }
}

/// Reports what is out of range in the sizes of a training run.
pub(crate) fn check_run(total_steps: u64, envs: u64, rollout_steps: u64, problems: &mut Problems) {
    problems.positive("envs", envs);
    problems.positive("rollout_steps", rollout_steps);
    let update = envs.saturating_mul(rollout_steps);
    if total_steps < update || total_steps == 0 {
        let message = format!(
            "`total_steps` is {total_steps}, expected at least one rollout: {update} (`envs` × `rollout_steps`)"
        );
        problems.add("total_steps", message);
    }
}

/// Reports what is wrong with an environment.
pub(crate) fn check_env(env: &dril_envs::EnvConfig, problems: &mut Problems) {
    for (path, message) in env.check() {
        problems.add(&format!("env.{path}"), message);
    }
}
