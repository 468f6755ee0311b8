//! The stage `collect`: records episodes that score above a threshold.

use dril_envs::{ActionRange, Demonstrations, DemosHeader, EnvConfig, Episode};
use dril_kinds::{Collect, CollectParams, Mode, PolicyFamily};
use dril_stage_api::{Ctx, Stage, StageError};

use super::act::{Play, PlayedEpisode, Player};
use crate::policy::Policy;

/// The stage `collect`.
pub struct CollectStage;

impl Stage for CollectStage {
    type Kind = Collect;

    fn run(params: &CollectParams, ctx: &mut Ctx<'_>) -> Result<(), StageError> {
        let policy = Policy::load("policy", ctx.input("policy")?)?;
        let play = Play {
            mode: params.mode,
            mean_action_probability: 0.0,
            first_seed: params.first_seed,
            episodes: params.max_attempts as usize,
            record: true,
        };
        let mut player = Player::new(&policy, &params.env, play, ctx.seed())?;
        let kept = choose(&mut player, params, ctx)?;
        let header = header(&params.env, params.mode, &policy)?;
        let demonstrations = Demonstrations { header, episodes: kept.into_iter().map(episode).collect() };
        demonstrations.write(ctx.output("demonstrations")?).map_err(StageError::failed)
    }
}

/// The attempts so far.
#[derive(Debug, Default)]
struct Attempts {
    /// Accepted episodes, by their index.
    kept: Vec<PlayedEpisode>,
    /// Indices of finished attempts.
    over: Vec<bool>,
    best: Option<f64>,
}

impl Attempts {
    fn add(&mut self, played: PlayedEpisode, above: f64) {
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

    /// True if the first `wanted` accepted episodes are known: every attempt before the last of them is finished.
    fn settled(&self, wanted: usize) -> bool {
        let Some(last) = wanted.checked_sub(1).and_then(|last| self.kept.get(last)) else { return false };
        self.over[..last.index].iter().all(|&over| over)
    }
}

/// Plays until the first accepted episodes are known.
fn choose(
    player: &mut Player<'_>,
    params: &CollectParams,
    ctx: &mut Ctx<'_>,
) -> Result<Vec<PlayedEpisode>, StageError> {
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

fn enough(mut attempts: Attempts, params: &CollectParams) -> Result<Vec<PlayedEpisode>, StageError> {
    let (wanted, found) = (params.episodes as usize, attempts.kept.len());
    if found < wanted {
        let tried = attempts.over.len();
        let best = attempts.best.unwrap_or(f64::NAN);
        return Err(StageError::failed(format!(
            "{found} of {tried} attempts scored above {}, expected {wanted}; the best scored {best:.1}: train the expert \
             longer (`total_timesteps`), lower `above`, or raise `max_attempts`",
            params.above
        )));
    }
    attempts.kept.truncate(wanted);
    Ok(attempts.kept)
}

/// What a recording of this agent in this environment says of itself.
pub(super) fn header(env: &EnvConfig, mode: Mode, policy: &Policy) -> Result<DemosHeader, StageError> {
    let architecture = policy.architecture();
    Ok(DemosHeader {
        env: env.clone(),
        observation_space: env.spaces().map_err(StageError::failed)?.0,
        action_dims: architecture.action_len(),
        action_range: match architecture.family {
            PolicyFamily::Gaussian | PolicyFamily::Categorical => ActionRange::Raw,
            PolicyFamily::Beta => ActionRange::Bounded,
        },
        mode: match mode {
            Mode::Deterministic => "deterministic",
            Mode::Stochastic => "stochastic",
        }
        .to_owned(),
    })
}

/// An episode that was played with [`Play::record`], as a recording has it.
pub(super) fn episode(played: PlayedEpisode) -> Episode {
    Episode {
        seed: played.seed,
        score: played.score,
        outcome: played.outcome,
        frames: played.frames,
        vectors: played.vectors,
        actions: played.actions,
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use dril_envs::Outcome;
    use dril_kinds::Network;
    use dril_stage_api::Seed;
    use dril_stage_api::testing::Bench;
    use serde_json::json;

    fn bench(above: f64, episodes: u64, family: PolicyFamily) -> Bench {
        let params = json!({
            "env": { "car-racing": { "time_limit": 7 } }, "episodes": episodes, "above": above, "max_attempts": 20,
            "first_seed": 30
        });
        let bench = Bench::new::<CollectStage>(&params, 1).unwrap();
        let path = bench.folder().join("policy");
        let architecture =
            crate::spaces::architecture(&EnvConfig::default(), family, None, Network::ExpertCnn).unwrap();
        Policy::new(architecture, &mut Seed(1).stream("init")).unwrap().save(&path).unwrap();
        bench.input("policy", &path, &[])
    }

    fn collected(above: f64, episodes: u64, family: PolicyFamily) -> Demonstrations {
        let bench = bench(above, episodes, family);
        bench.run().unwrap();
        Demonstrations::read(&bench.output("demonstrations").unwrap()).unwrap()
    }

    #[test]
    fn the_first_good_episodes_are_kept_with_what_was_seen_and_done() {
        let all = collected(-100.0, 20, PolicyFamily::Beta);
        assert_eq!(all.episodes.len(), 20);
        let mut scores: Vec<f64> = all.episodes.iter().map(|episode| episode.score).collect();
        scores.sort_by(f64::total_cmp);
        let some = collected(scores[9], 5, PolicyFamily::Beta);
        let good = all.episodes.iter().filter(|episode| episode.score > scores[9]);
        assert_eq!(some.episodes, good.take(5).cloned().collect::<Vec<_>>());
        for episode in &all.episodes {
            assert_eq!((episode.frames.len(), episode.actions.len()), (7 * 84 * 84, 14));
            assert_eq!(episode.outcome, Outcome::TimeLimit);
            assert!(episode.actions.iter().all(|action| (-1.0..=1.0).contains(action)));
        }
        assert_eq!(some.header.action_range, ActionRange::Bounded);
    }

    #[test]
    fn a_gaussians_actions_are_kept_as_it_gave_them() {
        let demonstrations = collected(-100.0, 20, PolicyFamily::Gaussian);
        assert_eq!(demonstrations.header.action_range, ActionRange::Raw);
        let beyond =
            demonstrations.episodes.iter().flat_map(|episode| &episode.actions).any(|a| a.abs() > 1.0);
        assert!(beyond, "a standard deviation of 1 leaves the range");
    }

    #[test]
    fn too_few_good_episodes_are_an_error_that_says_how_many_and_what_to_change() {
        let message = bench(900.0, 3, PolicyFamily::Beta).run().unwrap_err().to_string();
        for part in ["0 of 20 attempts", "above 900", "expected 3", "the best scored", "`max_attempts`"] {
            assert!(message.contains(part), "{message}");
        }
    }
}
