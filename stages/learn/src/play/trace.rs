//! The stage that writes what happens at each step of a few episodes, and what an ensemble says of it.
//!
//! Whoever acts, the episodes are first there as a recording. Rewards and poses come from playing its actions again,
//! so that a walk through demonstrations and an agent's own episode are traced by the same code.

use dril_envs::{ActionSpace, Demonstrations, DemosHeader, EnvConfig, Episode, MapLine};
use dril_kinds::{Trace, TraceParams};
use dril_stage_api::{Ctx, Stage, StageError};

use super::act::{Play, Player};
use super::collect;
use super::walk::Walk;
use crate::algorithms::dril::disagreement;
use crate::algorithms::dril::signal;
use crate::algorithms::ensemble::Ensemble;
use crate::data::frames::FrameStore;
use crate::data::transitions::{Transitions, frames_of};
use crate::policy::Policy;

/// Runs the kind `trace`.
pub struct TraceStage;

impl Stage for TraceStage {
    type Kind = Trace;

    fn run(params: &TraceParams, ctx: &mut Ctx<'_>) -> Result<(), StageError> {
        let (header, mut episodes) = match &params.env {
            Some(env) => played(params, env, ctx)?,
            None => recorded(params, ctx)?,
        };
        let walks = walk(params, &header, &episodes, ctx)?;
        if let (true, Some(first)) = (params.video, walks.first()) {
            first.write_images(ctx)?;
        }
        ctx.write_output("map", map(walks.first().map_or(&[], |walk| &walk.map))?)?;
        cut(&mut episodes, header.action_dims, params.steps);
        let judged = match ctx.optional_input("ensemble") {
            Some(path) => Some(judge(params, &header, &episodes, &Ensemble::load("ensemble", path)?, ctx)?),
            None => None,
        };
        ctx.write_output("steps", table(&header, &episodes, &walks, judged.as_ref())?)
    }
}

/// Episodes of the agent at the input `policy`.
fn played(
    params: &TraceParams,
    env: &EnvConfig,
    ctx: &mut Ctx<'_>,
) -> Result<(DemosHeader, Vec<Episode>), StageError> {
    let policy = Policy::load("policy", ctx.input("policy")?)?;
    let play = Play {
        mode: params.mode,
        mean_action_probability: params.mean_action_probability,
        first_seed: params.first_seed,
        episodes: params.episodes as usize,
        record: true,
    };
    let mut player = Player::new(&policy, env, play, ctx.seed())?;
    let mut ended = Vec::new();
    while let Some(more) = player.step()? {
        ended.extend(more);
        ctx.progress(ended.len() as u64, params.episodes, "episodes", String::new);
        ctx.stop_if_cancelled()?;
    }
    ended.sort_by_key(|episode| episode.index);
    let header = collect::header(env, params.mode, &policy)?;
    Ok((header, ended.into_iter().map(collect::episode).collect()))
}

/// The first episodes of the input `demonstrations`.
fn recorded(params: &TraceParams, ctx: &Ctx<'_>) -> Result<(DemosHeader, Vec<Episode>), StageError> {
    let path = ctx.input("demonstrations")?;
    let wrong = |message: String| StageError::input("demonstrations", path, message);
    let demos = Demonstrations::read(path).map_err(|error| wrong(error.to_string()))?;
    let (mut episodes, wanted) = (demos.episodes, params.episodes as usize);
    if episodes.len() < wanted {
        return Err(wrong(format!("has {} episodes, expected at least {wanted}", episodes.len())));
    }
    episodes.truncate(wanted);
    Ok((demos.header, episodes))
}

/// The episodes played again; nothing where that is not wanted. Only the first one is drawn.
fn walk(
    params: &TraceParams,
    header: &DemosHeader,
    episodes: &[Episode],
    ctx: &Ctx<'_>,
) -> Result<Vec<Walk>, StageError> {
    if !params.replay {
        return Ok(Vec::new());
    }
    let again = |(at, episode)| {
        ctx.stop_if_cancelled()?;
        Walk::again(header, episode, params.video && at == 0)
    };
    episodes.iter().enumerate().map(again).collect()
}

/// Leaves so many steps of all episodes together.
fn cut(episodes: &mut Vec<Episode>, dims: usize, steps: Option<u64>) {
    let Some(mut left) = steps.map(|steps| steps as usize) else { return };
    for episode in episodes.iter_mut() {
        let kept = episode.steps(dims).min(left);
        episode.actions.truncate(kept * dims);
        left -= kept;
    }
    episodes.retain(|episode| !episode.actions.is_empty());
}

/// What an ensemble says of each step.
struct Judged {
    costs: Vec<f64>,
    limits: Vec<f64>,
    signals: Vec<f32>,
    /// For discrete actions: the cost of every action, [action][step], and its limit.
    choices: Vec<(Vec<f64>, f64)>,
}

fn judge(
    params: &TraceParams,
    header: &DemosHeader,
    episodes: &[Episode],
    ensemble: &Ensemble,
    ctx: &Ctx<'_>,
) -> Result<Judged, StageError> {
    let Some(path) = ctx.optional_input("demonstrations") else {
        let message =
            "input `demonstrations` is not connected: the limit of the ensemble's cost is taken from them";
        return Err(StageError::Port(message.to_owned()));
    };
    let transitions = Transitions::load("demonstrations", path)?;
    let (seen, known) = (header.observation_space, ensemble.architecture());
    if known.observation != seen || known.actions.action_len() != header.action_dims {
        return Err(StageError::failed(format!(
            "the ensemble knows {:?} and actions of {} values, but the episodes have {seen:?} and {}; give it the \
             ensemble that was trained for this environment",
            known.observation,
            known.actions.action_len(),
            header.action_dims
        )));
    }
    if transitions.observation() != seen {
        return Err(StageError::failed(format!(
            "the demonstrations show {:?}, but the episodes {seen:?}; give it those that the ensemble learned from",
            transitions.observation()
        )));
    }
    let frames = store(header, episodes);
    let slots: Vec<usize> = (0..frames.len()).collect();
    let actions: Vec<f32> = episodes.iter().flat_map(|episode| &episode.actions).copied().collect();
    let (one, each) = signal::limits(ensemble, &transitions, params.quantile, params.thresholds)?;
    let costs = signal::costs(ensemble, &frames, &slots, &actions)?;
    let limit = |action: &[f32]| signal::limit(one, &each, action);
    let limits: Vec<f64> = actions.chunks_exact(header.action_dims).map(limit).collect();
    let judged = costs.iter().zip(&limits);
    let signals = judged.map(|(cost, limit)| disagreement::reward(params.reward, *cost, *limit)).collect();
    let choices = match known.actions {
        ActionSpace::Continuous { .. } => Vec::new(),
        ActionSpace::Discrete { .. } => {
            signal::choice_costs(ensemble, &frames, &slots)?.into_iter().zip(each).collect()
        }
    };
    Ok(Judged { costs, limits, signals, choices })
}

/// The observations of all steps that are left.
fn store(header: &DemosHeader, episodes: &[Episode]) -> FrameStore {
    let mut frames = FrameStore::new(header.observation_space);
    for episode in episodes {
        let steps = episode.steps(header.action_dims);
        for (step, frame) in frames_of(episode, &header.observation_space).take(steps).enumerate() {
            frames.push(frame, step == 0);
        }
    }
    frames
}

/// The output `steps`: what does not exist is empty.
fn table(
    header: &DemosHeader,
    episodes: &[Episode],
    walks: &[Walk],
    judged: Option<&Judged>,
) -> Result<Vec<u8>, StageError> {
    let dims = header.action_dims;
    let mut writer = csv::Writer::from_writer(Vec::new());
    let mut columns: Vec<String> =
        ["step", "episode", "seed", "episode_step", "reward", "score"].map(str::to_owned).to_vec();
    columns.extend((0..dims).map(|n| format!("action_{n}")));
    columns.extend(["cost", "limit", "signal", "x", "y", "angle", "speed"].map(str::to_owned));
    let choices = judged.map_or(0, |judged| judged.choices.len());
    columns.extend((0..choices).flat_map(|n| [format!("cost_{n}"), format!("limit_{n}")]));
    writer.write_record(&columns).map_err(StageError::failed)?;
    let mut row = 0;
    for (number, episode) in episodes.iter().enumerate() {
        let walk = walks.get(number);
        let mut score = 0.0;
        for (step, action) in episode.actions.chunks_exact(dims).enumerate() {
            let reward = walk.map(|walk| walk.rewards[step]);
            score += reward.unwrap_or(0.0);
            let mut cells: Vec<String> =
                [row as u64, number as u64, episode.seed, step as u64].map(|n| n.to_string()).to_vec();
            cells.extend([reward, reward.map(|_| score)].map(text));
            cells.extend(action.iter().map(ToString::to_string));
            let judgement = judged.map(|judged| (judged.costs[row], judged.limits[row], judged.signals[row]));
            cells.extend([judgement.map(|one| one.0), judgement.map(|one| one.1)].map(text));
            cells.push(text(judgement.map(|one| f64::from(one.2))));
            let pose = walk.and_then(|walk| walk.poses[step]);
            cells.extend(match pose {
                Some(pose) => [pose.x, pose.y, pose.angle, pose.speed].map(|value| text(Some(value))),
                None => Default::default(),
            });
            let choices = judged.map_or(&[][..], |judged| &judged.choices);
            cells.extend(
                choices.iter().flat_map(|(costs, limit)| [costs[row], *limit]).map(|value| text(Some(value))),
            );
            writer.write_record(&cells).map_err(StageError::failed)?;
            row += 1;
        }
    }
    writer.into_inner().map_err(StageError::failed)
}

/// The output `map`: one row per point.
fn map(lines: &[MapLine]) -> Result<Vec<u8>, StageError> {
    let mut writer = csv::Writer::from_writer(Vec::new());
    writer.write_record(["line", "x", "y"]).map_err(StageError::failed)?;
    for line in lines {
        for [x, y] in &line.points {
            let cells = [line.name.to_owned(), x.to_string(), y.to_string()];
            writer.write_record(cells).map_err(StageError::failed)?;
        }
    }
    writer.into_inner().map_err(StageError::failed)
}

fn text(value: Option<f64>) -> String {
    value.map_or_else(String::new, |value| value.to_string())
}

#[cfg(test)]
#[path = "trace_tests.rs"]
mod tests;
