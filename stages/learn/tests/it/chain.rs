//! The chain from nothing to scores, at the smallest size: ppo, collect, dataset, bc, ensemble, dril, evaluate.
//!
//! What the stages compute has its own tests; here each must take what the one before it wrote.

use std::path::{Path, PathBuf};

use dril_envs::Demonstrations;
use dril_learn::algorithms::bc::BcStage;
use dril_learn::algorithms::dril::DrilStage;
use dril_learn::algorithms::ensemble::EnsembleStage;
use dril_learn::algorithms::ppo_stage::PpoStage;
use dril_learn::data::dataset::DatasetStage;
use dril_learn::play::collect::CollectStage;
use dril_learn::play::evaluate::EvaluateStage;
use dril_stage_api::scores::{self, ScoreRow};
use dril_stage_api::testing::Bench;
use dril_stage_api::{Stage, StageError};
use serde_json::{Value, json};

/// A stage that has run; its files last as long as it does.
fn run<S: Stage>(params: &Value, inputs: &[(&str, PathBuf)]) -> Result<Bench, StageError> {
    let mut bench = Bench::new::<S>(params, 66)?;
    for (port, path) in inputs {
        bench = bench.input(port, path, &[]);
    }
    bench.run()?;
    Ok(bench)
}

/// Episodes of 60 steps.
fn env() -> Value {
    json!({ "car-racing": { "time_limit": 60 } })
}

fn evaluate(policy: PathBuf) -> Result<Vec<ScoreRow>, StageError> {
    let params = json!({ "env": env(), "mode": "stochastic", "episodes": 2, "first_seed": 1000 });
    let bench = run::<EvaluateStage>(&params, &[("policy", policy)])?;
    scores::read("scores", &bench.output("scores")?)
}

fn rows(log: &Path) -> Result<usize, StageError> {
    let text = std::fs::read_to_string(log).map_err(StageError::io("cannot read", log))?;
    Ok(text.lines().count() - 1)
}

#[test]
fn each_stage_takes_what_the_one_before_it_wrote() -> Result<(), StageError> {
    let expert = json!({
        "env": env(), "policy": "gaussian", "total_timesteps": 64, "n_envs": 2, "n_steps": 16, "n_epochs": 1,
        "n_minibatches": 2
    });
    let expert = run::<PpoStage>(&expert, &[])?;
    assert_eq!(rows(&expert.output("log")?)?, 2);

    let recording =
        json!({ "env": env(), "episodes": 3, "above": -1000.0, "max_attempts": 8, "first_seed": 1 });
    let recording = run::<CollectStage>(&recording, &[("policy", expert.output("policy")?)])?;

    let set = json!({ "actions": "clipped", "trajectories": 2 });
    let set = run::<DatasetStage>(&set, &[("demonstrations", recording.output("demonstrations")?)])?;
    let demonstrations = set.output("demonstrations")?;
    let packed = Demonstrations::read(&demonstrations).map_err(StageError::failed)?;
    assert_eq!(packed.episodes.len(), 2);
    assert!(packed.episodes.iter().all(|episode| episode.actions.iter().all(|action| action.abs() <= 1.0)));

    let clone = json!({ "policy": "beta", "n_epochs": 2, "batch_size": 32 });
    let clone = run::<BcStage>(&clone, &[("demonstrations", demonstrations.clone())])?;
    let ensemble = json!({ "n_members": 3, "n_epochs": 2, "batch_size": 33 });
    let ensemble = run::<EnsembleStage>(&ensemble, &[("demonstrations", demonstrations.clone())])?;
    assert_eq!((rows(&clone.output("log")?)?, rows(&ensemble.output("log")?)?), (2, 2));

    let dril = json!({
        "env": env(), "total_timesteps": 128, "n_envs": 2, "n_steps": 64, "n_epochs": 1, "n_minibatches": 2,
        "bc_batch_size": 16
    });
    let dril = run::<DrilStage>(
        &dril,
        &[
            ("policy", clone.output("policy")?),
            ("ensemble", ensemble.output("ensemble")?),
            ("demonstrations", demonstrations),
        ],
    )?;
    for port in ["peak", "final"] {
        let scores = evaluate(dril.output(port)?)?;
        let seeds: Vec<u64> = scores.iter().map(|row| row.seed).collect();
        assert_eq!(seeds, [1000, 1001]);
        assert!(scores.iter().all(|row| row.steps == 60 && row.outcome == "time-limit"), "{scores:?}");
    }
    Ok(())
}
