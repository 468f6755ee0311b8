//! DRIL as a whole, in CarRacing at the smallest size, and its parts in a made-up world of vectors.

use std::path::Path;

use dril_envs::{ActionRange, Demonstrations, DemosHeader, EnvConfig, Episode, Outcome};
use dril_kinds::{Network, PolicyFamily};
use dril_stage_api::Seed;
use dril_stage_api::testing::Bench;
use serde_json::{Value, json};

use super::*;
use crate::bc::tests::{outputs, stop_often};
use crate::disagreement::{MemberOutputs, reward};
use crate::ensemble;
use crate::frames::FrameStore;
use crate::imitation::Imitator;
use crate::net::Observation;
use crate::pairs::tests::vector_demos;
use crate::policy::Architecture;
use crate::rollout::Rollout;
use crate::spaces::Actions;

const OUTPUTS: [&str; 3] = ["peak", "final", "log"];

/// Episodes of two steps, rollouts of three steps in two environments, two minibatches of PPO and of cloning each.
fn params(updates: u64) -> Value {
    json!({
        "env": { "car-racing": { "time_limit": 2 } },
        "total_steps": 6 * updates, "envs": 2, "rollout_steps": 3, "epochs": 1, "minibatches": 2,
        "bc_batch_size": 4, "peak_window": 3
    })
}

fn with(mut params: Value, field: &str, value: Value) -> Value {
    params[field] = value;
    params
}

/// A bench with an untrained agent, an untrained ensemble and four made-up steps of an expert.
fn bench(params: &Value, seed: u64) -> Bench {
    fast::prepare();
    let bench = Bench::new::<DrilStage>(params, seed).unwrap();
    let folder = bench.folder().to_owned();
    let (observation, actions) = spaces::of(&EnvConfig::default()).unwrap();
    let (network, family) = (Network::DrilCnn, PolicyFamily::Beta);
    let architecture = Architecture { network, family, observation, actions: actions.count() };
    Policy::new(architecture, &mut Seed(7).stream("init")).unwrap().save(&folder.join("policy")).unwrap();
    let members = ensemble::Architecture::new(observation, actions, 2);
    let members = Ensemble::new(members, &mut Seed(7).stream("init")).unwrap();
    std::fs::write(folder.join("ensemble"), members.to_bytes().unwrap()).unwrap();
    expert(4).write(&folder.join("demos")).unwrap();
    bench.input("policy", &folder.join("policy"), &[]).input("ensemble", &folder.join("ensemble"), &[]).input(
        "demonstrations",
        &folder.join("demos"),
        &[],
    )
}

fn expert(steps: usize) -> Demonstrations {
    let env = EnvConfig::default();
    let (observation_space, action) = env.spaces().unwrap();
    let (pixels, action_dims) = (observation_space.frame_len(), action.action_len());
    let episode = Episode {
        seed: 1,
        score: 910.0,
        outcome: Outcome::Finished,
        frames: (0..steps * pixels).map(|at| (at % 251) as u8).collect(),
        vectors: Vec::new(),
        actions: (0..steps * action_dims).map(|at| (at as f32).sin()).collect(),
    };
    let (action_range, mode) = (ActionRange::Bounded, "stochastic".to_owned());
    let header = DemosHeader { env, observation_space, action_dims, action_range, mode };
    Demonstrations { header, episodes: vec![episode] }
}

fn read(path: &Path) -> Vec<u8> {
    std::fs::read(path).unwrap()
}

fn cells(log: &[u8], column: &str) -> Vec<String> {
    let mut reader = csv::Reader::from_reader(log);
    let at = reader.headers().unwrap().iter().position(|header| header == column).unwrap();
    reader.records().map(|row| row.unwrap()[at].to_owned()).collect()
}

#[test]
fn a_training_that_was_stopped_again_and_again_ends_with_the_same_bytes() {
    let whole = outputs(&bench(&params(2), 1), &OUTPUTS);
    let stopped = bench(&params(2), 1);
    // Two steps and two minibatches of an update can be stopped after, so the stops fall into the first rollout, the
    // first update and the second rollout.
    stop_often(&stopped, 5);
    assert_eq!(outputs(&stopped, &OUTPUTS), whole);
    assert_ne!(outputs(&bench(&params(2), 2), &OUTPUTS)[1], whole[1], "another seed gives another agent");
}

#[test]
fn the_peak_is_the_agent_that_earned_the_score_or_on_request_the_one_after() {
    let before = bench(&params(1), 1);
    let made = outputs(&before, &OUTPUTS);
    assert_eq!(
        made[0],
        read(&before.folder().join("policy")),
        "the only rollout was played by the first agent"
    );
    assert_ne!(made[0], made[1]);
    assert_eq!(cells(&made[2], "peak_update"), ["0"]);
    assert_eq!(cells(&made[2], "peak_episodes"), ["2"], "fewer episodes than the window have ended");
    let after = outputs(&bench(&with(params(1), "peak", json!("after")), 1), &OUTPUTS);
    assert_eq!(after[0], after[1]);
}

#[test]
fn where_no_episode_ends_the_peak_is_the_agent_at_the_start() {
    let bench = bench(&with(params(2), "env", json!({ "car-racing": { "time_limit": 1000 } })), 1);
    let made = outputs(&bench, &OUTPUTS);
    assert_eq!(made[0], read(&bench.folder().join("policy")));
    assert_eq!(cells(&made[2], "peak_update"), ["", ""]);
    assert_eq!(cells(&made[2], "u_signal"), ["", ""]);
}

#[test]
fn the_log_has_what_only_dril_knows() {
    let log = outputs(&bench(&params(2), 1), &["log"]).remove(0);
    let numbers =
        |column| -> Vec<f64> { cells(&log, column).iter().map(|cell| cell.parse().unwrap()).collect() };
    assert!(numbers("u_signal").iter().all(|mean| (-1.0..=1.0).contains(mean)));
    assert!(numbers("disagreement").iter().all(|cost| *cost >= 0.0));
    let cloning = numbers("bc_loss");
    assert!(cloning[1] < cloning[0], "the demonstrations are learnt beside: {cloning:?}");
    assert_eq!(numbers("step"), [6.0, 12.0]);
}

#[test]
fn an_ensemble_for_other_observations_is_refused() {
    let bench = bench(&params(1), 1);
    let other = ensemble::Architecture::new(Observation::Vector { len: 3 }, Actions::Numbers(2), 2);
    let other = Ensemble::new(other, &mut Seed(7).stream("init")).unwrap();
    std::fs::write(bench.folder().join("ensemble"), other.to_bytes().unwrap()).unwrap();
    let message = bench.run().unwrap_err().to_string();
    assert!(message.contains("the input `ensemble` is of Vector"), "{message}");
}

/// An ensemble and pairs of the made-up world.
fn vector_world() -> (Ensemble, Pairs) {
    fast::prepare();
    let folder = tempfile::tempdir().unwrap();
    vector_demos(&[30, 20]).write(&folder.path().join("demos")).unwrap();
    let pairs = Pairs::load("demonstrations", &folder.path().join("demos")).unwrap();
    let members = ensemble::Architecture::new(pairs.observation(), pairs.kind(), 5);
    (Ensemble::new(members, &mut Seed(3).stream("init")).unwrap(), pairs)
}

#[test]
fn rewards_follow_from_the_cost_of_each_entrys_own_observation_and_action() {
    let (ensemble, pairs) = vector_world();
    let params =
        json!({ "env": { "car-racing": {} }, "envs": 2, "quantile": 0.5, "normalize_reward": false });
    let params: DrilParams = serde_json::from_value(params).unwrap();
    let mut signal = Signal::new(&ensemble, &pairs, &params).unwrap();
    let mut rollout = Rollout::new(pairs.observation(), 2, 2, 3);
    rollout.frames = FrameStore::with_slots(pairs.observation(), rollout.frames.len());
    let seen: Vec<[f32; 2]> = (0..6).map(|entry| [entry as f32 - 2.0, 0.5 * entry as f32]).collect();
    for (entry, seen) in seen.iter().enumerate() {
        rollout.frames.set(rollout.entry_slot(entry), dril_envs::Frame::Vector(seen), true);
    }
    rollout.actions = (0..12).map(|at| (at as f32 * 0.7).sin() * 1.5).collect();
    rollout.ends = vec![false, false, true, false, false, true];
    let summary = signal.replace_rewards(&mut rollout).unwrap();
    let wanted: Vec<f32> = seen
        .iter()
        .zip(rollout.actions.chunks(2))
        .map(|(seen, action)| {
            let answers = ensemble.answers(&tch::Tensor::from_slice(seen).view([1, 2]));
            let cost = MemberOutputs::new(answers, 5, 2).unwrap().continuous_cost(0, action);
            reward(params.reward, cost, signal.state().threshold)
        })
        .collect();
    assert_eq!(rollout.rewards, wanted);
    assert!(wanted.contains(&1.0) && wanted.contains(&-1.0), "both rewards occur: {wanted:?}");
    let first = (wanted[0] + wanted[2]) / 2.0;
    let second = (wanted[1] + wanted[3] + wanted[5]) / 3.0;
    assert!((summary.u_signal.unwrap() - f64::from((first + second) / 2.0)).abs() < 1e-6);
}

#[test]
fn each_choice_has_a_threshold_of_its_own_unless_the_last_one_s_is_asked_for() {
    let (_, pairs) = vector_world();
    let members = ensemble::Architecture::new(pairs.observation(), Actions::Choices(4), 5);
    let ensemble = Ensemble::new(members, &mut Seed(3).stream("init")).unwrap();
    let signal = |thresholds: &str| {
        let params = json!({
            "env": { "car-racing": {} }, "quantile": 0.9, "envs": 1, "normalize_reward": false, "thresholds": thresholds
        });
        Signal::new(&ensemble, &pairs, &serde_json::from_value(params).unwrap()).unwrap()
    };
    let all: Vec<usize> = (0..pairs.len()).collect();
    let outputs = MemberOutputs::new(ensemble.answers(&pairs.observations(&all)), 5, 4).unwrap();
    let wanted: Vec<f64> = (0..4)
        .map(|choice| {
            let costs: Vec<f64> = (0..pairs.len()).map(|at| outputs.discrete_cost(at, choice)).collect();
            crate::disagreement::quantile(&costs, 0.9).unwrap()
        })
        .collect();
    assert_eq!(signal("per-choice").state().thresholds, wanted);
    assert_eq!(signal("last-choice").state().thresholds, [wanted[3]; 4]);
    // Each entry's reward follows from its own choice.
    let mut rollout = Rollout::new(pairs.observation(), 1, 1, 4);
    for entry in 0..4 {
        rollout.frames.set(rollout.entry_slot(entry), dril_envs::Frame::Vector(&[9.0, -9.0]), true);
    }
    rollout.actions = vec![0.0, 1.0, 2.0, 3.0];
    signal("per-choice").replace_rewards(&mut rollout).unwrap();
    let far = ensemble.answers(&tch::Tensor::from_slice(&[9.0_f32, -9.0]).view([1, 2]));
    let far = MemberOutputs::new(far, 5, 4).unwrap();
    for (choice, (found, limit)) in rollout.rewards.iter().zip(&wanted).enumerate() {
        let scheme = dril_kinds::RewardScheme::PlusMinusOne;
        assert_eq!(*found, reward(scheme, far.discrete_cost(0, choice), *limit));
    }
}

#[test]
fn actor_critic_makes_one_step_a_rollout_and_goes_on_after_stops() {
    let params = with(params(3), "algorithm", json!("a2c"));
    let whole = outputs(&bench(&params, 1), &OUTPUTS);
    assert_ne!(whole[0], whole[1]);
    let stopped = bench(&params, 1);
    // Two steps and one minibatch of each update can be stopped after.
    stop_often(&stopped, 8);
    assert_eq!(outputs(&stopped, &OUTPUTS), whole);
}

#[test]
fn half_of_the_demonstrated_pairs_lie_below_a_threshold_at_the_median() {
    let (ensemble, pairs) = vector_world();
    let of = |quantile: f64| {
        let params = json!({ "env": { "car-racing": {} }, "quantile": quantile });
        let params: DrilParams = serde_json::from_value(params).unwrap();
        Signal::new(&ensemble, &pairs, &params).unwrap().state().threshold
    };
    let median = of(0.5);
    let all: Vec<usize> = (0..pairs.len()).collect();
    let answers = ensemble.answers(&pairs.observations(&all));
    let outputs = MemberOutputs::new(answers, 5, 2).unwrap();
    let costs = crate::disagreement::continuous_costs(&outputs, &pairs.action_values(&all));
    assert_eq!(costs.iter().filter(|cost| **cost <= median).count(), 25);
    assert!(of(0.98) > median);
}

#[test]
fn a_step_of_cloning_lowers_its_loss_and_leaves_the_critic_alone() {
    let (_, pairs) = vector_world();
    let architecture = Architecture {
        network: Network::Mlp,
        family: PolicyFamily::Gaussian,
        observation: pairs.observation(),
        actions: 2,
    };
    let mut policy = Policy::new(architecture, &mut Seed(3).stream("init")).unwrap();
    let all: Vec<usize> = (0..pairs.len()).collect();
    let loss = |policy: &Policy| {
        policy.validation_loss(&pairs.observations(&all), &pairs.actions(&all)).double_value(&[])
    };
    let critic = |policy: &Policy| policy.values(&pairs.observations(&all)).double_value(&[7]);
    let (loss_before, critic_before) = (loss(&policy), critic(&policy));
    let mut cloning = Cloning::new(&policy, &pairs, all.clone(), (20, 1e-3), Seed(3));
    for _ in 0..30 {
        cloning.step(&mut policy).unwrap();
    }
    assert!(loss(&policy) < 0.8 * loss_before);
    assert_eq!(critic(&policy), critic_before);
    assert!(cloning.mean_loss() < loss_before);
    assert!(cloning.mean_loss().is_nan(), "nothing was learnt since");
}
