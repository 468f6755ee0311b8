//! The stage that records the episodes in which an expert did well.

use dril_envs::{ActionRange, Demonstrations, DemosHeader, Episode};
use dril_kinds::{Collect, CollectParams, Mode, PolicyFamily};
use dril_stage_api::{Ctx, Stage, StageError};

use crate::act::{Play, Played, Player};
use crate::fast;
use crate::policy::Policy;

/// Runs the kind `collect`.
pub struct CollectStage;

impl Stage for CollectStage {
    type Kind = Collect;

    fn run(params: &CollectParams, ctx: &mut Ctx<'_>) -> Result<(), StageError> {
        fast::prepare();
        let policy = Policy::load("policy", ctx.input("policy")?)?;
        let play = Play {
            mode: params.mode,
            mean_action_probability: 0.0,
            first_track_seed: params.first_track_seed,
            episodes: params.max_attempts as usize,
            record: true,
        };
        let mut player = Player::new(&policy, &params.env, play, ctx.seed())?;
        let kept = choose(&mut player, params, ctx)?;
        let header = header(params, &policy);
        let demonstrations = Demonstrations { header, episodes: kept.into_iter().map(episode).collect() };
        demonstrations.write(ctx.output("demonstrations")?).map_err(StageError::failed)
    }
}

/// What the attempts have come to so far.
#[derive(Debug, Default)]
struct Attempts {
    /// Those with a good score, by their place in the list.
    kept: Vec<Played>,
    /// Which ones are over.
    over: Vec<bool>,
    best: Option<f64>,
}

impl Attempts {
    fn add(&mut self, played: Played, above: f64) {
        if self.over.len() <= played.index {
            self.over.resize(played.index + 1, false);
        }
        self.over[played.index] = true;
        self.best = Some(self.best.map_or(played.score, |best| best.max(played.score)));
        if played.score > above {
            let at = self.kept.partition_point(|other| other.index < played.index);
            self.kept.insert(at, played);
        }
    }

    /// True where the first `wanted` good episodes of the list are known: every attempt before the last of them is over.
    fn settled(&self, wanted: usize) -> bool {
        let Some(last) = wanted.checked_sub(1).and_then(|last| self.kept.get(last)) else { return false };
        self.over[..last.index].iter().all(|&over| over)
    }
}

/// Plays until the first good episodes of the list are known.
fn choose(
    player: &mut Player<'_>,
    params: &CollectParams,
    ctx: &mut Ctx<'_>,
) -> Result<Vec<Played>, StageError> {
    let wanted = params.episodes as usize;
    let mut attempts = Attempts::default();
    while !attempts.settled(wanted) {
        let Some(ended) = player.step()? else { break };
        ended.into_iter().for_each(|played| attempts.add(played, params.above));
        let found = attempts.kept.len().min(wanted);
        let tried = attempts.over.iter().filter(|&&over| over).count();
        ctx.progress(found as u64, params.episodes, "episodes", || format!("{tried} attempts"));
        ctx.stop_if_cancelled()?;
    }
    enough(attempts, params)
}

fn enough(mut attempts: Attempts, params: &CollectParams) -> Result<Vec<Played>, StageError> {
    let (wanted, found) = (params.episodes as usize, attempts.kept.len());
    if found < wanted {
        let tried = attempts.over.len();
        let best = attempts.best.unwrap_or(f64::NAN);
        return Err(StageError::failed(format!(
            "{found} of {tried} attempts scored above {}, expected {wanted}; the best scored {best:.1}: train the expert \
             longer (`total_steps`), lower `above`, or raise `max_attempts`",
            params.above
        )));
    }
    attempts.kept.truncate(wanted);
    Ok(attempts.kept)
}

fn header(params: &CollectParams, policy: &Policy) -> DemosHeader {
    let architecture = policy.architecture();
    DemosHeader {
        env: params.env.clone(),
        observation_space: params.env.spaces().0,
        action_dims: architecture.actions,
        action_range: match architecture.family {
            PolicyFamily::Gaussian => ActionRange::Raw,
            PolicyFamily::Beta => ActionRange::Bounded,
        },
        mode: match params.mode {
            Mode::Deterministic => "deterministic",
            Mode::Stochastic => "stochastic",
        }
        .to_owned(),
    }
}

fn episode(played: Played) -> Episode {
    Episode {
        seed: played.track_seed,
        score: played.score,
        outcome: played.outcome,
        frames: played.frames,
        vectors: played.vectors,
        actions: played.actions,
    }
}
