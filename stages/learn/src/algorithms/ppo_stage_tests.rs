//! Proximal policy optimisation as a whole, in a world of one number and in CarRacing at the smallest size.

use dril_envs::{ActionSpace, ObservationSpace, Outcome};
use dril_kinds::PolicyFamily;
use dril_stage_api::Seed;
use dril_stage_api::testing::Bench;
use serde_json::{Value, json};
use std::sync::atomic::Ordering::Relaxed;
use std::time::Duration;

use super::*;
use crate::algorithms::bc::tests::{outputs, stop_often};
use crate::nn::Batch;
use crate::play::act::act;
use crate::test_env::Echo;

const OUTPUTS: [&str; 3] = ["policy", "log", "episodes"];

/// The kind `ppo` in the world of one number.
struct Tiny;

impl Stage for Tiny {
    type Kind = Ppo;

    fn run(params: &PpoParams, ctx: &mut Ctx<'_>) -> Result<(), StageError> {
        let observation = ObservationSpace::Vector { len: 1 };
        let (count, family) = (params.on_policy.n_envs as usize, params.policy);
        let (envs, actions) = match family {
            PolicyFamily::Categorical => (Echo::choosing(count, 10), ActionSpace::Discrete { actions: 3 }),
            _ => (Echo::several(count, 10, Outcome::TimeLimit), ActionSpace::Continuous { dims: 1 }),
        };
        train(params, Architecture { network: Network::Mlp, family, observation, actions }, envs, ctx)
    }
}

fn tiny(family: &str, updates: u64) -> Value {
    json!({
        "env": { "car-racing": {} }, "policy": family, "n_envs": 4, "n_steps": 32, "total_timesteps": 128 * updates,
        "n_epochs": 4, "n_minibatches": 4, "learning_rate": 3e-3, "clip_range": 0.2, "ent_coef": 0.0, "gamma": 0.5
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
        "env": { "car-racing": {} }, "policy": "gaussian", "n_envs": 2, "n_steps": 12, "total_timesteps": 48,
        "n_epochs": 2, "n_minibatches": 3, "mean_action_probability": 0.3
    });
    let whole = outputs(&Bench::new::<Tiny>(&params, 1).unwrap(), &OUTPUTS);
    let stopped = Bench::new::<Tiny>(&params, 1).unwrap();
    // Two updates of 12 steps (the last of which goes over into the update) and 6 minibatches have 34 places to stop at.
    stop_often(&stopped, 34);
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
    let bootstrapped = outputs(&Bench::new::<Tiny>(&params, 1).unwrap(), &OUTPUTS);
    params["bootstrap_time_limits"] = json!(false);
    let ends = outputs(&Bench::new::<Tiny>(&params, 1).unwrap(), &OUTPUTS);
    assert_ne!(bootstrapped[0], ends[0]);
}

#[test]
fn a_network_that_diverges_is_an_error_that_says_what_to_try() {
    let mut params = tiny("gaussian", 3);
    params["learning_rate"] = json!(1e30);
    params["on_divergence"] = json!("error");
    let message = Bench::new::<Tiny>(&params, 1).unwrap().run().unwrap_err().to_string();
    assert!(message.contains("diverged") && message.contains("learning_rate"), "{message}");
}

#[test]
fn a_network_that_diverges_keeps_its_last_finite_weights_where_that_is_asked_for() {
    let mut params = tiny("gaussian", 3);
    params["learning_rate"] = json!(1e30);
    params["on_divergence"] = json!("keep-last-finite");
    let bench = Bench::new::<Tiny>(&params, 1).unwrap();
    let [_, log, _]: [Vec<u8>; 3] = outputs(&bench, &OUTPUTS).try_into().unwrap();
    assert_eq!(cells(&log, "diverged"), [1.0], "training ends with the update that diverged");
    // Reading it checks that every weight is finite.
    let policy = Policy::load("policy", &bench.output("policy").unwrap()).unwrap();
    assert_eq!(policy.diverged_at_step, Some(128));
}

#[test]
fn the_agent_of_a_training_that_diverged_can_act() {
    // Weights of the order of the rate are finite, and their products over the layers are not.
    for (family, epochs) in [("gaussian", 1), ("gaussian", 2), ("beta", 1), ("beta", 2)] {
        let params = json!({
            "env": { "car-racing": { "time_limit": 5 } }, "policy": family, "n_envs": 1, "n_steps": 4, "total_timesteps": 8,
            "n_epochs": epochs, "n_minibatches": 1, "learning_rate": 1e15, "on_divergence": "keep-last-finite"
        });
        let bench = Bench::new::<PpoStage>(&params, 1).unwrap();
        bench.run().unwrap_or_else(|error| panic!("{family}, {epochs} epochs: {error}"));
        let policy = Policy::load("policy", &bench.output("policy").unwrap()).unwrap();
        assert_eq!(policy.diverged_at_step, Some(4));
        let ObservationSpace::Image { height, width, stack } = policy.architecture().observation else {
            panic!("images")
        };
        let batch = Batch::Images { rows: 1, bytes: vec![100; stack * height * width] };
        let acted = act(&policy, &batch, 0.0, &mut Seed(1).stream("action"));
        assert!(
            acted.actions.iter().chain(&acted.values).all(|x| x.is_finite()),
            "{family}, {epochs} epochs: {acted:?}"
        );
    }
}

#[test]
fn a_gaussian_begins_with_the_deviation_and_the_means_that_are_asked_for() {
    let params = json!({
        "env": { "car-racing": { "time_limit": 5 } }, "policy": "gaussian", "n_envs": 1, "n_steps": 4,
        "total_timesteps": 4, "n_epochs": 1, "n_minibatches": 1, "learning_rate": 1e-9,
        "initial_deviation": 0.37, "mean_gain": 0.01, "initial_mean": [0.0, 0.25]
    });
    let bench = Bench::new::<PpoStage>(&params, 1).unwrap();
    bench.run().unwrap();
    let policy = Policy::load("policy", &bench.output("policy").unwrap()).unwrap();
    let of = |name: &str| {
        let id = policy.params().ids().find(|id| policy.params().spec(*id).name == name).unwrap();
        policy.params().slice(id).to_vec()
    };
    assert!((of("head.log_std")[0] - 0.37_f32.ln()).abs() < 1e-6);
    assert!((of("head.mean.bias")[1] - 0.25).abs() < 1e-6);
    let norm = of("head.mean.weight")[..512].iter().map(|weight| weight * weight).sum::<f32>().sqrt();
    assert!((norm - 0.01).abs() < 1e-6, "{norm}");
}

#[test]
fn every_finished_episode_has_a_row_and_survives_stops() {
    let params = tiny("beta", 3);
    let whole = outputs(&Bench::new::<Tiny>(&params, 1).unwrap(), &OUTPUTS).remove(2);
    // Three rollouts of 32 steps in four environments with episodes of 10 steps.
    assert_eq!(cells(&whole, "episode"), (0..36).map(f64::from).collect::<Vec<_>>());
    assert_eq!(cells(&whole, "step")[..8], [40.0, 40.0, 40.0, 40.0, 80.0, 80.0, 80.0, 80.0]);
    assert_eq!(cells(&whole, "update")[35], 2.0);
    assert!(cells(&whole, "length").iter().all(|length| *length == 10.0));
    assert!(cells(&whole, "u_signal").iter().all(|signal| signal.is_nan()), "only DRIL has one");
}

#[test]
fn the_stage_trains_on_images_and_its_agent_can_be_read() {
    let params = json!({
        "env": { "car-racing": { "time_limit": 5 } }, "policy": "beta", "n_envs": 2, "n_steps": 8,
        "total_timesteps": 32, "n_epochs": 1, "n_minibatches": 2
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
        "env": { "car-racing": { "time_limit": 8 } }, "policy": "beta", "n_envs": 2, "n_steps": 4,
        "total_timesteps": 32, "n_epochs": 1, "n_minibatches": 2, "stagger": 8
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
    let [policy, log, _]: [Vec<u8>; 3] = outputs(&first, &OUTPUTS).try_into().unwrap();
    assert_eq!(cells(&log, "update").len(), 40);
    let second = Bench::new::<Tiny>(&leg(40, 60), 2).unwrap();
    let file = second.folder().join("first-leg.safetensors");
    std::fs::write(&file, policy).unwrap();
    let second = second.input("policy", &file, &[]);
    let [_, log, _]: [Vec<u8>; 3] = outputs(&second, &OUTPUTS).try_into().unwrap();
    assert_eq!(cells(&log, "step"), (41..=60).map(|n| f64::from(n * 128)).collect::<Vec<_>>());
    let rates = cells(&log, "learning_rate");
    assert!((rates[0] - 3e-3 / 3.0).abs() < 1e-12 && (rates[19] - 3e-3 / 60.0).abs() < 1e-12);
    let scores = cells(&log, "score_mean_10");
    assert!(scores[1] > 7.0, "it begins where the first leg ended: {scores:?}");
}
