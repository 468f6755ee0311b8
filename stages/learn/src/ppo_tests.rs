//! Proximal policy optimisation as a whole, in a world of one number and in CarRacing at the smallest size.

use dril_envs::Outcome;
use dril_stage_api::testing::Bench;
use serde_json::{Value, json};
use std::sync::atomic::Ordering::Relaxed;
use std::time::Duration;

use super::*;
use crate::bc::tests::{outputs, stop_often};
use crate::net::Observation;
use crate::policy::{Architecture, PolicyFamily};
use crate::test_env::Echo;

const OUTPUTS: [&str; 2] = ["policy", "log"];

/// The kind `ppo` in the world of one number.
struct Tiny;

impl Stage for Tiny {
    type Kind = Ppo;

    fn run(params: &PpoParams, ctx: &mut Ctx<'_>) -> Result<(), StageError> {
        fast::prepare();
        let observation = Observation::Vector { len: 1 };
        let (count, family) = (params.envs as usize, params.policy);
        let (envs, actions) = match family {
            PolicyFamily::Categorical => (Echo::choosing(count, 10), 3),
            _ => (Echo::several(count, 10, Outcome::TimeLimit), 1),
        };
        let architecture = Architecture { network: Network::Mlp, family, observation, actions };
        let policy = beginner(params, architecture, ctx)?;
        let (policy, log) = train(params, policy, envs, ctx)?;
        ctx.write_output("policy", policy.to_bytes()?)?;
        ctx.write_output("log", log.to_csv()?)
    }
}

fn tiny(family: &str, updates: u64) -> Value {
    json!({
        "env": { "car-racing": {} }, "policy": family, "envs": 4, "rollout_steps": 32, "total_steps": 128 * updates,
        "epochs": 4, "minibatches": 4, "learning_rate": 3e-3, "clip_range": 0.2, "entropy_coef": 0.0, "gamma": 0.5
    })
}

fn cells(log: &[u8], column: &str) -> Vec<f64> {
    let mut reader = csv::Reader::from_reader(log);
    let at = reader.headers().unwrap().iter().position(|header| header == column).unwrap();
    reader.records().map(|row| row.unwrap()[at].parse().unwrap_or(f64::NAN)).collect()
}

#[test]
fn both_families_learn_to_say_the_number_they_see() {
    for family in ["gaussian", "beta"] {
        let outputs = outputs(&Bench::new::<Tiny>(&tiny(family, 60), 1).unwrap(), &OUTPUTS);
        let scores = cells(&outputs[1], "score_mean_100");
        // Of 10 at most; saying 0 all the time gives 5.
        assert!(scores[1] < 5.5 && scores[59] > 7.5, "{family}: {scores:?}");
        assert_eq!(cells(&outputs[1], "step"), (1..=60).map(|n| f64::from(n * 128)).collect::<Vec<_>>());
        let rates = cells(&outputs[1], "learning_rate");
        assert!((rates[0] - 3e-3).abs() < 1e-12 && (rates[59] - 3e-3 / 60.0).abs() < 1e-12);
    }
}

#[test]
fn choices_are_learnt() {
    let outputs = outputs(&Bench::new::<Tiny>(&tiny("categorical", 60), 1).unwrap(), &OUTPUTS);
    let scores = cells(&outputs[1], "score_mean_100");
    // Of 10 at most; a third comes by chance.
    assert!(scores[0] < 5.0 && scores[59] > 7.5, "{scores:?}");
}

#[test]
fn equal_seeds_give_equal_bytes_and_another_seed_gives_others() {
    let of = |seed| outputs(&Bench::new::<Tiny>(&tiny("beta", 3), seed).unwrap(), &OUTPUTS);
    let first = of(1);
    assert_eq!(first, of(1));
    assert_ne!(first[0], of(2)[0]);
    let beside = std::thread::scope(|scope| {
        let neighbour = scope.spawn(|| of(3));
        let one = of(1);
        let _ = neighbour.join();
        one
    });
    assert_eq!(first, beside, "whatever else runs beside");
}

#[test]
fn a_training_that_was_stopped_after_every_step_ends_with_the_same_bytes() {
    let params = json!({
        "env": { "car-racing": {} }, "policy": "gaussian", "envs": 2, "rollout_steps": 12, "total_steps": 48,
        "epochs": 2, "minibatches": 3, "mean_action_probability": 0.3
    });
    let whole = outputs(&Bench::new::<Tiny>(&params, 1).unwrap(), &OUTPUTS);
    let stopped = Bench::new::<Tiny>(&params, 1).unwrap();
    // Two updates of 12 steps and 6 minibatches each have 36 places to stop at.
    stop_often(&stopped, 36);
    assert_eq!(outputs(&stopped, &OUTPUTS), whole);
    let saving = Bench::new::<Tiny>(&params, 1).unwrap().checkpoint_seconds(0.0);
    assert_eq!(outputs(&saving, &OUTPUTS), whole);
}

#[test]
fn a_training_that_was_stopped_at_any_moment_ends_with_the_same_bytes() {
    let whole = outputs(&Bench::new::<Tiny>(&tiny("beta", 6), 1).unwrap(), &OUTPUTS);
    let stopped = Bench::new::<Tiny>(&tiny("beta", 6), 1).unwrap();
    for wait in [3, 40, 11] {
        std::thread::scope(|scope| {
            scope.spawn(|| {
                std::thread::sleep(Duration::from_millis(wait));
                stopped.cancel.store(true, Relaxed);
            });
            // A fast machine may be done before it is stopped.
            assert!(matches!(stopped.run(), Err(StageError::Cancelled) | Ok(_)));
        });
        stopped.cancel.store(false, Relaxed);
    }
    assert_eq!(outputs(&stopped, &OUTPUTS), whole);
}

#[test]
fn a_checkpoint_that_is_cut_off_means_a_new_start_with_the_same_result() {
    let whole = outputs(&Bench::new::<Tiny>(&tiny("beta", 2), 1).unwrap(), &OUTPUTS);
    let stopped = Bench::new::<Tiny>(&tiny("beta", 2), 1).unwrap();
    stop_often(&stopped, 5);
    let file = stopped.folder().join("checkpoints/state");
    let bytes = std::fs::read(&file).unwrap();
    std::fs::write(&file, &bytes[..bytes.len() - 1]).unwrap();
    assert_eq!(outputs(&stopped, &OUTPUTS), whole);
}

#[test]
fn an_agent_that_learnt_from_scaled_observations_carries_their_statistics() {
    let mut params = tiny("gaussian", 40);
    params["normalize_observations"] = json!(true);
    params["normalize_reward"] = json!(true);
    let bench = Bench::new::<Tiny>(&params, 1).unwrap();
    let whole = outputs(&bench, &OUTPUTS);
    let scores = cells(&whole[1], "score_mean_100");
    assert!(scores[39] > scores[1] + 1.0, "scores are the environment's own: {scores:?}");
    let policy = Policy::load("policy", &bench.output("policy").unwrap()).unwrap();
    let statistics = policy.statistics.clone().unwrap();
    // Numbers from -1 to 1 have mean 0 and variance 1/3.
    let shown = statistics.scale(&[1.0])[0];
    assert!((shown - 3.0_f32.sqrt()).abs() < 0.1, "{shown}");
    assert_eq!(policy.to_bytes().unwrap(), whole[0]);
    let stopped = Bench::new::<Tiny>(&params, 1).unwrap();
    stop_often(&stopped, 50);
    assert_eq!(outputs(&stopped, &OUTPUTS), whole);
}

#[test]
fn short_numbers_learn_too_and_give_equal_bytes_after_stops() {
    let mut params = tiny("beta", 40);
    params["precision"] = json!("bf16");
    let whole = outputs(&Bench::new::<Tiny>(&params, 1).unwrap(), &OUTPUTS);
    let scores = cells(&whole[1], "score_mean_100");
    assert!(scores[39] > scores[1] + 1.0, "{scores:?}");
    let stopped = Bench::new::<Tiny>(&params, 1).unwrap();
    stop_often(&stopped, 40);
    assert_eq!(outputs(&stopped, &OUTPUTS), whole);
    assert_ne!(outputs(&Bench::new::<Tiny>(&tiny("beta", 40), 1).unwrap(), &OUTPUTS)[0], whole[0]);
}

#[test]
fn curves_are_written_where_they_are_asked_for_and_change_nothing() {
    let plain = outputs(&Bench::new::<Tiny>(&tiny("beta", 3), 1).unwrap(), &OUTPUTS);
    let folder = tempfile::tempdir().unwrap();
    let watched = Bench::new::<Tiny>(&tiny("beta", 3), 1).unwrap().curves(&folder.path().join("a"));
    assert_eq!(outputs(&watched, &OUTPUTS), plain);
    let files: Vec<_> = std::fs::read_dir(folder.path().join("a")).unwrap().collect();
    assert_eq!(files.len(), 1);
    let bytes = std::fs::read(files[0].as_ref().unwrap().path()).unwrap();
    let count = |name: &[u8]| bytes.windows(name.len()).filter(|window| *window == name).count();
    assert_eq!((count(b"brain.Event:2"), count(b"approx_kl"), count(b"steps_per_second")), (1, 3, 2));
}

#[test]
fn time_limits_taken_as_real_ends_give_another_agent() {
    let mut params = tiny("beta", 2);
    let mended = outputs(&Bench::new::<Tiny>(&params, 1).unwrap(), &OUTPUTS);
    params["bootstrap_time_limits"] = json!(false);
    let ends = outputs(&Bench::new::<Tiny>(&params, 1).unwrap(), &OUTPUTS);
    assert_ne!(mended[0], ends[0]);
}

#[test]
fn a_network_that_diverges_is_an_error_that_says_what_to_try() {
    let mut params = tiny("gaussian", 3);
    params["learning_rate"] = json!(1e30);
    let message = Bench::new::<Tiny>(&params, 1).unwrap().run().unwrap_err().to_string();
    assert!(message.contains("diverged") && message.contains("learning_rate"), "{message}");
}

#[test]
fn the_stage_trains_on_pictures_and_its_agent_can_be_read() {
    let params = json!({
        "env": { "car-racing": { "time_limit": 5 } }, "policy": "beta", "envs": 2, "rollout_steps": 8,
        "total_steps": 32, "epochs": 1, "minibatches": 2
    });
    let bench = Bench::new::<PpoStage>(&params, 1).unwrap();
    let made = outputs(&bench, &OUTPUTS);
    assert_eq!(cells(&made[1], "episodes"), [2.0, 6.0]);
    let policy = Policy::load("policy", &bench.output("policy").unwrap()).unwrap();
    assert_eq!(policy.architecture().network, Network::ExpertCnn);
    assert_eq!(policy.to_bytes().unwrap(), made[0]);
    let stopped = Bench::new::<PpoStage>(&params, 1).unwrap();
    stop_often(&stopped, 11);
    assert_eq!(outputs(&stopped, &OUTPUTS), made);
}

#[test]
fn staggered_first_episodes_spread_the_ends_and_a_stop_does_not_disturb_that() {
    let params = json!({
        "env": { "car-racing": { "time_limit": 8 } }, "policy": "beta", "envs": 2, "rollout_steps": 4,
        "total_steps": 32, "epochs": 1, "minibatches": 2, "stagger": 8
    });
    let bench = Bench::new::<PpoStage>(&params, 1).unwrap();
    let made = outputs(&bench, &OUTPUTS);
    assert_eq!(cells(&made[1], "episodes"), [1.0, 2.0, 3.0, 4.0], "all end together without it: 0, 2, 2, 4");
    let stopped = Bench::new::<PpoStage>(&params, 1).unwrap();
    stop_often(&stopped, 7);
    assert_eq!(outputs(&stopped, &OUTPUTS), made);
}

#[test]
fn a_training_goes_on_where_another_stage_ended_it_with_the_learning_rate_of_the_whole() {
    let leg = |from: u64, to: u64| {
        let mut params = tiny("beta", 60);
        params["from_step"] = json!(128 * from);
        params["to_step"] = json!(128 * to);
        params
    };
    let first = Bench::new::<Tiny>(&leg(0, 40), 1).unwrap();
    let [policy, log]: [Vec<u8>; 2] = outputs(&first, &OUTPUTS).try_into().unwrap();
    assert_eq!(cells(&log, "update").len(), 40);
    let second = Bench::new::<Tiny>(&leg(40, 60), 2).unwrap();
    let file = second.folder().join("first-leg.safetensors");
    std::fs::write(&file, policy).unwrap();
    let second = second.input("policy", &file, &[]);
    let [_, log]: [Vec<u8>; 2] = outputs(&second, &OUTPUTS).try_into().unwrap();
    assert_eq!(cells(&log, "step"), (41..=60).map(|n| f64::from(n * 128)).collect::<Vec<_>>());
    let rates = cells(&log, "learning_rate");
    assert!((rates[0] - 3e-3 / 3.0).abs() < 1e-12 && (rates[19] - 3e-3 / 60.0).abs() < 1e-12);
    let scores = cells(&log, "score_mean_10");
    assert!(scores[1] > 7.0, "it begins where the first leg ended: {scores:?}");
}
