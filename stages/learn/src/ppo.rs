//! Proximal policy optimisation (Schulman et al. 2017): the stage that trains experts.
//!
//! The whole loop is in [`train`]; the loss is in [`crate::update`], the state in [`crate::learner`]: DRIL shares both.

use dril_envs::VecEnv;
use dril_kinds::{Ppo, PpoParams};
use dril_stage_api::{Ctx, Stage, StageError};
use serde::{Deserialize, Serialize};

use crate::checkpoint::{self, Arrays};
use crate::fast;
use crate::learner::{LOG_COLUMNS, Learner, LearnerSettings, LearnerState, log_row};
use crate::log::{RecentScores, Speed, TrainingLog};
use crate::made_with;
use crate::net::Network;
use crate::policy::{Architecture, Policy};
use crate::rollout::SamplerSettings;
use crate::spaces;
use crate::tensorboard::Curves;

/// Runs the kind `ppo`.
pub struct PpoStage;

impl Stage for PpoStage {
    type Kind = Ppo;

    fn run(params: &PpoParams, ctx: &mut Ctx<'_>) -> Result<(), StageError> {
        fast::prepare();
        made_with::tell(ctx);
        let architecture =
            spaces::architecture(&params.env, params.policy, params.network, Network::ExpertCnn)?;
        let policy = beginner(params, architecture, ctx)?;
        let mut envs = VecEnv::new(&params.env, params.envs as usize, 1).map_err(StageError::failed)?;
        if params.stagger > 0 {
            envs.stagger(params.stagger as usize);
        }
        let (policy, log) = train(params, policy, envs, ctx)?;
        ctx.write_output("policy", policy.to_bytes()?)?;
        ctx.write_output("log", log.to_csv()?)
    }
}

/// The agent that training begins with: the one that is handed in, or a new one.
fn beginner(params: &PpoParams, architecture: Architecture, ctx: &mut Ctx<'_>) -> Result<Policy, StageError> {
    let Some(path) = ctx.optional_input("policy") else {
        return Policy::new(architecture, &mut ctx.stream("init"));
    };
    let policy = Policy::load("policy", path)?;
    if policy.architecture() != architecture {
        let (seen, wanted) = (policy.architecture(), architecture);
        let message = format!(
            "is an agent of {seen:?}, expected {wanted:?}, which `env`, `policy` and `network` ask for"
        );
        return Err(StageError::input("policy", path, message));
    }
    if policy.statistics.is_some() != params.normalize_observations {
        let message = "has other statistics of observations than `normalize_observations` asks for; set that field as in \
                       the stage that made the agent";
        return Err(StageError::input("policy", path, message));
    }
    Ok(policy)
}

fn settings(params: &PpoParams) -> LearnerSettings {
    LearnerSettings {
        envs: params.envs as usize,
        rollout_steps: params.rollout_steps as usize,
        total_steps: params.total_steps,
        steps: params.from_step..params.to_step(),
        learning_rate: params.learning_rate,
        anneal_learning_rate: params.anneal_learning_rate,
        adam_epsilon: params.adam_epsilon,
        update: params.update(),
        sampler: SamplerSettings {
            mean_action_probability: params.mean_action_probability,
            bootstrap_time_limits: params.bootstrap_time_limits,
            normalize_observations: params.normalize_observations,
        },
        normalize_reward: params.normalize_reward,
        precision: params.precision,
    }
}

/// What a checkpoint holds beside the arrays.
#[derive(Serialize, Deserialize)]
struct State {
    learner: LearnerState,
    scores: RecentScores,
    log: TrainingLog,
}

/// The whole training: rollouts and updates in turn until the steps are used up.
///
/// # Errors
/// The environment's, a network that has diverged, or a stop on request (after a checkpoint).
pub fn train(
    params: &PpoParams,
    policy: Policy,
    envs: VecEnv,
    ctx: &mut Ctx<'_>,
) -> Result<(Policy, TrainingLog), StageError> {
    let mut learner = Learner::new(settings(params), policy, envs, ctx.seed());
    let (mut scores, mut log) = (RecentScores::default(), TrainingLog::new(&LOG_COLUMNS));
    match checkpoint::load::<State>(ctx.checkpoints())? {
        Some((state, mut arrays)) => {
            (scores, log) = (state.scores, state.log);
            learner.restore(state.learner, &mut arrays)?;
        }
        None => learner.start()?,
    }
    let mut curves = Curves::open(ctx)?;
    let speed = Speed::from(learner.steps_done());
    while !learner.finished() {
        while !learner.rollout_full() {
            learner.step()?.iter().for_each(|episode| scores.push(episode.score));
            let (done, total) = (learner.steps_done(), learner.last_step());
            ctx.progress(done, total, "steps", || {
                format!("score {:.0}, {:.0} steps/s", scores.mean(10), speed.at(done))
            });
            save_if_due(ctx, &learner, &scores, &log)?;
        }
        if !learner.updating() {
            learner.begin_update();
        }
        while let Some(minibatch) = learner.next_minibatch() {
            learner.learn(&minibatch)?;
            save_if_due(ctx, &learner, &scores, &log)?;
        }
        let (update, step, rate) = (learner.updates_done(), learner.steps_done(), learner.learning_rate());
        log.push(&log_row(update, step, rate, &scores, &learner.end_update()));
        curves.last_row(step, &log)?;
    }
    Ok((learner.into_policy(), log))
}

/// Saves a checkpoint where it is time; stops after it where a stop was asked for.
fn save_if_due(
    ctx: &mut Ctx<'_>,
    learner: &Learner,
    scores: &RecentScores,
    log: &TrainingLog,
) -> Result<(), StageError> {
    if ctx.checkpoint_due() {
        let mut arrays = Arrays::new();
        let state = State { learner: learner.save(&mut arrays), scores: scores.clone(), log: log.clone() };
        checkpoint::save(ctx.checkpoints(), &state, &arrays)?;
    }
    ctx.stop_if_cancelled()
}

#[cfg(test)]
#[path = "ppo_tests.rs"]
mod tests;
