//! The stage `evaluate`: plays the episodes of a fixed list of seeds and writes their scores.
//!
//! A checkpoint contains the finished episodes; the others are restarted, with the same result.
//!
//! All policies are evaluated on the same seeds, one episode each, whatever its length; see [`super::act::WIDTH`] for why
//! an episode's score does not depend on the others.

use dril_envs::Outcome;
use dril_kinds::{Counted, Evaluate, EvaluateParams};
use dril_stage_api::scores::{self, ScoreRow};
use dril_stage_api::{Ctx, Stage, StageError};

use super::act::{Play, PlayedEpisode, Player};
use crate::policy::Policy;
use crate::training::checkpoint::{self, Arrays};

/// The stage `evaluate`.
pub struct EvaluateStage;

impl Stage for EvaluateStage {
    type Kind = Evaluate;

    fn run(params: &EvaluateParams, ctx: &mut Ctx<'_>) -> Result<(), StageError> {
        let policy = Policy::load("policy", ctx.input("policy")?)?;
        let play = Play {
            mode: params.mode,
            mean_action_probability: params.mean_action_probability,
            first_seed: params.first_seed,
            episodes: match params.counted {
                Counted::Listed => params.episodes as usize,
                Counted::FirstFinished => usize::MAX,
            },
            record: false,
        };
        let mut player = Player::new(&policy, &params.env, play, ctx.seed())?;
        let mut rows = match checkpoint::load::<Vec<ScoreRow>>(ctx.checkpoints())? {
            Some((rows, _)) => rows,
            None => Vec::new(),
        };
        player.skip(rows.iter().map(|row| row.episode));
        while rows.len() < params.episodes as usize
            && let Some(ended) = player.step()?
        {
            rows.extend(ended.iter().map(|played| row(played, &policy)));
            ctx.progress(rows.len() as u64, params.episodes, "episodes", || mean(&rows));
            // Which episodes finish first is only known by playing all of them again.
            if params.counted == Counted::Listed && ctx.checkpoint_due() {
                checkpoint::save(ctx.checkpoints(), &rows, &Arrays::new())?;
            }
            ctx.stop_if_cancelled()?;
        }
        scores::write(ctx.output("scores")?, &counted(rows, params))
    }
}

/// The counted rows, numbered: in the order of the list, or in the order in which they finished.
fn counted(mut rows: Vec<ScoreRow>, params: &EvaluateParams) -> Vec<ScoreRow> {
    match params.counted {
        Counted::Listed => rows.sort_by_key(|row| row.episode),
        Counted::FirstFinished => {
            rows.truncate(params.episodes as usize);
            rows.iter_mut().enumerate().for_each(|(at, row)| row.episode = at);
        }
    }
    rows
}

fn row(played: &PlayedEpisode, policy: &Policy) -> ScoreRow {
    ScoreRow {
        episode: played.index,
        seed: played.seed,
        score: played.score,
        steps: played.steps,
        outcome: outcome(played.outcome).to_owned(),
        diverged_at_step: policy.diverged_at_step,
    }
}

/// The name of an outcome in the table of scores.
fn outcome(outcome: Outcome) -> &'static str {
    match outcome {
        Outcome::Running => "running",
        Outcome::Finished => "finished",
        Outcome::Failed => "failed",
        Outcome::TimeLimit => "time-limit",
    }
}

fn mean(rows: &[ScoreRow]) -> String {
    let sum: f64 = rows.iter().map(|row| row.score).sum();
    if rows.is_empty() { String::new() } else { format!("score {:.0}", sum / rows.len() as f64) }
}

#[cfg(test)]
mod tests {
    use super::*;
    use dril_envs::EnvConfig;
    use dril_kinds::{Network, PolicyFamily};
    use dril_stage_api::Seed;
    use dril_stage_api::testing::Bench;
    use serde_json::json;

    fn scores(episodes: u64, mode: &str) -> Vec<ScoreRow> {
        play_scores(json!({ "episodes": episodes, "mode": mode }))
    }

    fn play_scores(with: serde_json::Value) -> Vec<ScoreRow> {
        play_on(with, None)
    }

    /// As after a stop, with these episodes in the checkpoint.
    fn play_on(with: serde_json::Value, done: Option<&[ScoreRow]>) -> Vec<ScoreRow> {
        let mut params = json!({
            "env": { "car-racing": { "time_limit": 6 } }, "mode": "stochastic", "first_seed": 30
        });
        params.as_object_mut().unwrap().extend(with.as_object().unwrap().clone());
        let bench = Bench::new::<EvaluateStage>(&params, 1).unwrap();
        let path = bench.folder().join("policy");
        let architecture =
            crate::spaces::architecture(&EnvConfig::default(), PolicyFamily::Beta, None, Network::ExpertCnn);
        Policy::new(architecture.unwrap(), &mut Seed(1).stream("init")).unwrap().save(&path).unwrap();
        if let Some(done) = done {
            checkpoint::save(&bench.folder().join("checkpoints"), &done, &Arrays::new()).unwrap();
        }
        let bench = bench.input("policy", &path, &[]).checkpoint_seconds(0.0);
        bench.run().unwrap();
        scores::read("scores", &bench.output("scores").unwrap()).unwrap()
    }

    #[test]
    fn the_first_that_finish_count_where_that_is_asked_for() {
        let row = |episode: usize| ScoreRow {
            episode,
            seed: 30 + episode as u64,
            score: 1.0,
            steps: 6,
            outcome: "finished".into(),
            diverged_at_step: None,
        };
        let mut params: EvaluateParams = serde_json::from_value(json!({
            "env": { "car-racing": {} }, "mode": "stochastic", "episodes": 3, "first_seed": 30
        }))
        .unwrap();
        let finished = vec![row(5), row(0), row(13), row(1)];
        let seeds = |params: &EvaluateParams| -> Vec<(usize, u64)> {
            counted(finished.clone(), params).iter().map(|row| (row.episode, row.seed)).collect()
        };
        assert_eq!(seeds(&params), [(0, 30), (1, 31), (5, 35), (13, 43)]);
        params.counted = Counted::FirstFinished;
        assert_eq!(seeds(&params), [(0, 35), (1, 30), (2, 43)]);
        // With episodes of equal length the first row's second episode comes after everybody's first.
        let rows = play_scores(json!({ "episodes": 10, "counted": "first-finished" }));
        let seeds: Vec<u64> = rows.iter().map(|row| row.seed).collect();
        assert_eq!(seeds, (30..40).collect::<Vec<_>>());
        assert!(rows.iter().enumerate().all(|(at, row)| row.episode == at));
    }

    #[test]
    fn scores_stand_in_the_order_of_the_list_and_do_not_depend_on_its_length() {
        for mode in ["deterministic", "stochastic"] {
            let rows = scores(10, mode);
            let seeds: Vec<(usize, u64)> = rows.iter().map(|row| (row.episode, row.seed)).collect();
            assert_eq!(seeds, (0..10).map(|i| (i, 30 + i as u64)).collect::<Vec<_>>());
            assert!(rows.iter().all(|row| row.steps == 6 && row.outcome == "time-limit"));
            assert_eq!(scores(3, mode), rows[..3]);
        }
    }
    #[test]
    fn episodes_of_a_checkpoint_are_not_played_again_and_the_others_come_out_the_same() {
        let with = json!({ "episodes": 20 });
        let whole = play_scores(with.clone());
        let mut done: Vec<ScoreRow> = [9, 0, 2, 10, 18].map(|at: usize| whole[at].clone()).to_vec();
        assert_eq!(play_on(with.clone(), Some(&done)), whole);
        done[0].score = 1234.5;
        assert_eq!(play_on(with, Some(&done))[9].score, 1234.5);
    }
}
