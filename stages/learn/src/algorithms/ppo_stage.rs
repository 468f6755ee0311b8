//! The stage `ppo`: trains a policy on the environment's own reward. The loop is [`super::on_policy`], the algorithm
//! [`super::ppo`].

use dril_envs::{ObservationSpace, VecEnv};
use dril_kinds::{Algorithm, Network, Ppo, PpoParams};
use dril_stage_api::{Ctx, Stage, StageError};

use super::on_policy::{Hooks, Settings, Trained, Training};
use crate::policy::{Architecture, HeadInit, Policy};
use crate::spaces;
use crate::training::checkpoint::Arrays;

/// Runs the kind `ppo`.
pub struct PpoStage;

impl Stage for PpoStage {
    type Kind = Ppo;

    fn run(params: &PpoParams, ctx: &mut Ctx<'_>) -> Result<(), StageError> {
        let architecture =
            spaces::architecture(&params.env, params.policy, params.network, Network::ExpertCnn)?;
        let mut envs =
            VecEnv::new(&params.env, params.on_policy.n_envs as usize, 1).map_err(StageError::failed)?;
        if params.stagger > 0 {
            envs.stagger(params.stagger as usize);
        }
        train(params, architecture, envs, ctx)
    }
}

/// Trains in the given environments and writes the outputs.
fn train(
    params: &PpoParams,
    architecture: Architecture,
    envs: VecEnv,
    ctx: &mut Ctx<'_>,
) -> Result<(), StageError> {
    let mut policy = initial_policy(params, architecture, ctx)?;
    policy.network_mut().set_device(params.on_policy.device)?;
    let mut settings = Settings::new(&params.on_policy, params.update, Algorithm::Ppo, params.on_divergence);
    settings.from_step = params.from_step;
    settings.normalize_observations = params.normalize_observations;
    settings.normalize_reward = params.on_policy.normalize_reward;
    let training = Training::start(settings, policy, envs, ctx, |_, _| Ok(NoHooks))?;
    let Trained { policy, log, episodes, .. } = training.run(ctx)?;
    ctx.write_output("policy", policy.to_bytes()?)?;
    ctx.write_output("log", log.to_csv()?)?;
    ctx.write_output("episodes", episodes.to_csv()?)
}

/// PPO needs no hooks.
struct NoHooks;

impl Hooks for NoHooks {
    type State = ();

    fn save(&self, _: &mut Arrays) {}
}

/// The initial policy: the one at the input, or a new one.
fn initial_policy(
    params: &PpoParams,
    architecture: Architecture,
    ctx: &Ctx<'_>,
) -> Result<Policy, StageError> {
    let Some(path) = ctx.optional_input("policy") else {
        let init = HeadInit {
            gain: params.mean_gain,
            deviation: params.initial_deviation,
            mean: params.initial_mean.clone(),
        };
        return Policy::with_head(architecture, &init, &mut ctx.stream("init"));
    };
    let policy = Policy::load("policy", path)?;
    if policy.architecture() != architecture {
        let (seen, wanted) = (policy.architecture(), architecture);
        let message =
            format!("has the architecture {seen:?}, expected {wanted:?} from `env`, `policy` and `network`");
        return Err(StageError::input("policy", path, message));
    }
    let normalizes =
        params.normalize_observations && matches!(architecture.observation, ObservationSpace::Vector { .. });
    if policy.statistics.is_some() != normalizes {
        let message = "was trained with another setting of `normalize_observations`; set it as in the stage that made the \
                       policy";
        return Err(StageError::input("policy", path, message));
    }
    Ok(policy)
}

#[cfg(test)]
#[path = "ppo_stage_tests.rs"]
mod tests;
