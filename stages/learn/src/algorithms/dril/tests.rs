//! DRIL as a whole, in CarRacing at the smallest size, and its parts in a made-up world of vectors.

use std::path::Path;

use dril_envs::{
    ActionRange, ActionSpace, Demonstrations, DemosHeader, EnvConfig, Episode, ObservationSpace, Outcome,
};
use dril_kinds::{Network, PolicyFamily};
use dril_stage_api::Seed;
use dril_stage_api::testing::Bench;
use serde_json::{Value, json};

use super::disagreement::{MemberOutputs, reward};
use super::*;
use crate::algorithms::bc::tests::{outputs, stop_often};
use crate::algorithms::ensemble;
use crate::algorithms::imitation::Imitator;
use crate::data::frames::FrameStore;
use crate::data::transitions::tests::vector_demos;
use crate::nn::Batch;
use crate::policy::Architecture;

const OUTPUTS: [&str; 5] = ["peak", "peak-after", "final", "log", "episodes"];

/// Episodes of two steps, rollouts of three steps in two environments, two minibatches of PPO and of cloning each.
fn params(updates: u64) -> Value {
    json!({
        "env": { "car-racing": { "time_limit": 2 } },
        "total_timesteps": 6 * updates, "n_envs": 2, "n_steps": 3, "n_epochs": 1, "n_minibatches": 2,
        "bc_batch_size": 4, "peak_window": 3
    })
}

fn with(mut params: Value, field: &str, value: Value) -> Value {
    params[field] = value;
    params
}

/// A bench with an untrained agent, an untrained ensemble and four made-up steps of an expert.
fn bench(params: &Value, seed: u64) -> Bench {
    let bench = Bench::new::<DrilStage>(params, seed).unwrap();
    let folder = bench.folder().to_owned();
    let (observation, actions) = spaces::of(&EnvConfig::default()).unwrap();
    let (network, family) = (Network::DrilCnn, PolicyFamily::Beta);
    let architecture = Architecture { network, family, observation, actions };
    Policy::new(architecture, &mut Seed(7).stream("init")).unwrap().save(&folder.join("policy")).unwrap();
    let members = ensemble::EnsembleArchitecture { observation, actions, members: 2 };
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
    assert_ne!(outputs(&bench(&params(2), 2), &OUTPUTS)[2], whole[2], "another seed gives another agent");
}

#[test]
fn the_peak_is_the_agent_that_earned_the_score_and_the_one_after_is_kept_too() {
    let bench = bench(&params(1), 1);
    let [peak, peak_after, last, log, _]: [Vec<u8>; 5] = outputs(&bench, &OUTPUTS).try_into().unwrap();
    assert_eq!(peak, read(&bench.folder().join("policy")), "the only rollout was played by the first agent");
    assert_ne!(peak, last);
    assert_eq!(peak_after, last);
    assert_eq!(cells(&log, "peak_update"), ["0"]);
    assert_eq!(cells(&log, "peak_episodes"), ["2"], "fewer episodes than the window have ended");
}

#[test]
fn a_run_that_ends_early_is_the_beginning_of_the_long_one() {
    let long = outputs(&bench(&params(3), 1), &["log", "episodes"]);
    let short = outputs(&bench(&with(params(3), "to_step", json!(12)), 1), &["log", "episodes"]);
    for (short, long) in short.iter().zip(&long) {
        assert!(long.starts_with(short) && long.len() > short.len());
    }
}

#[test]
fn the_constant_reward_does_not_depend_on_the_ensemble() {
    let signals = |reward: &str| {
        let params = with(with(params(2), "reward", json!(reward)), "quantile", json!(0.0));
        cells(&outputs(&bench(&params, 1), &["episodes"])[0], "u_signal")
    };
    assert!(signals("constant").iter().all(|signal| signal == "1"));
    assert!(signals("plus-minus-one").iter().any(|signal| signal != "1"));
}

#[test]
fn a_diverging_training_keeps_the_peak_and_the_last_finite_weights() {
    let bench = bench(&with(params(3), "learning_rate", json!(1e38)), 1);
    let [peak, _, last, log, _]: [Vec<u8>; 5] = outputs(&bench, &OUTPUTS).try_into().unwrap();
    assert_eq!(cells(&log, "diverged").last().unwrap(), "1");
    for (bytes, port) in [(peak, "peak"), (last, "final")] {
        let path = bench.folder().join(port);
        std::fs::write(&path, bytes).unwrap();
        // Reading it checks that every weight is finite.
        assert!(Policy::load(port, &path).unwrap().diverged_at_step.is_some());
    }
    let fails = with(with(params(3), "learning_rate", json!(1e38)), "on_divergence", json!("error"));
    let message = self::bench(&fails, 1).run().unwrap_err().to_string();
    assert!(message.contains("diverged at step"), "{message}");
}

#[test]
fn where_no_episode_ends_the_peak_is_the_agent_at_the_start() {
    let bench = bench(&with(params(2), "env", json!({ "car-racing": { "time_limit": 1000 } })), 1);
    let made = outputs(&bench, &OUTPUTS);
    assert_eq!(made[0], read(&bench.folder().join("policy")));
    assert_eq!(cells(&made[3], "peak_update"), ["", ""]);
    assert_eq!(cells(&made[3], "u_signal"), ["", ""]);
    assert_eq!(cells(&made[4], "episode"), [""; 0]);
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
    let other = ensemble::EnsembleArchitecture {
        observation: ObservationSpace::Vector { len: 3 },
        actions: ActionSpace::Continuous { dims: 2 },
        members: 2,
    };
    let other = Ensemble::new(other, &mut Seed(7).stream("init")).unwrap();
    std::fs::write(bench.folder().join("ensemble"), other.to_bytes().unwrap()).unwrap();
    let message = bench.run().unwrap_err().to_string();
    assert!(message.contains("the input `ensemble` has observations Vector"), "{message}");
}

/// An ensemble and transitions of the made-up world.
fn vector_world() -> (Ensemble, Transitions) {
    let folder = tempfile::tempdir().unwrap();
    vector_demos(&[30, 20]).write(&folder.path().join("demos")).unwrap();
    let transitions = Transitions::load("demonstrations", &folder.path().join("demos")).unwrap();
    let members = ensemble::EnsembleArchitecture {
        observation: transitions.observation(),
        actions: transitions.action_space(),
        members: 5,
    };
    (Ensemble::new(members, &mut Seed(3).stream("init")).unwrap(), transitions)
}

#[test]
fn rewards_follow_from_the_cost_of_each_entrys_own_observation_and_action() {
    let (ensemble, transitions) = vector_world();
    let params =
        json!({ "env": { "car-racing": {} }, "n_envs": 2, "quantile": 0.5, "normalize_reward": false });
    let params: DrilParams = serde_json::from_value(params).unwrap();
    let mut signal = Signal::new(&ensemble, &transitions, &params).unwrap();
    let mut rollout = Rollout::new(transitions.observation(), 2, 2, 3);
    rollout.frames = FrameStore::with_slots(transitions.observation(), rollout.frames.len());
    let seen: Vec<[f32; 2]> = (0..6).map(|entry| [entry as f32 - 2.0, 0.5 * entry as f32]).collect();
    for (entry, seen) in seen.iter().enumerate() {
        rollout.frames.set(rollout.entry_slot(entry), dril_envs::Frame::Vector(seen), true);
    }
    rollout.actions = (0..12).map(|at| (at as f32 * 0.7).sin() * 1.5).collect();
    rollout.dones = vec![false, false, true, false, false, true];
    let (summary, signals) = signal.replace_rewards(&mut rollout).unwrap();
    let wanted: Vec<f32> = seen
        .iter()
        .zip(rollout.actions.chunks(2))
        .map(|(seen, action)| {
            let answers = ensemble.answers(&Batch::Vectors { rows: 1, numbers: seen.to_vec() });
            let cost = MemberOutputs::new(answers, 5, 2).unwrap().continuous_cost(0, action);
            reward(params.reward, cost, signal.state().threshold)
        })
        .collect();
    assert_eq!(rollout.rewards, wanted);
    assert!(wanted.contains(&1.0) && wanted.contains(&-1.0), "both rewards occur: {wanted:?}");
    let first = (wanted[0] + wanted[2]) / 2.0;
    let second = (wanted[1] + wanted[3] + wanted[5]) / 3.0;
    assert_eq!(signals.len(), 2);
    assert!((signals[0] - f64::from(first)).abs() < 1e-6 && (signals[1] - f64::from(second)).abs() < 1e-6);
    assert!((summary.u_signal.unwrap() - f64::from((first + second) / 2.0)).abs() < 1e-6);
}

#[test]
fn each_choice_has_a_threshold_of_its_own_unless_the_last_one_s_is_asked_for() {
    let (_, transitions) = vector_world();
    let members = ensemble::EnsembleArchitecture {
        observation: transitions.observation(),
        actions: ActionSpace::Discrete { actions: 4 },
        members: 5,
    };
    let ensemble = Ensemble::new(members, &mut Seed(3).stream("init")).unwrap();
    let signal = |thresholds: &str| {
        let params = json!({
            "env": { "car-racing": {} }, "quantile": 0.9, "n_envs": 1, "normalize_reward": false, "thresholds": thresholds
        });
        Signal::new(&ensemble, &transitions, &serde_json::from_value(params).unwrap()).unwrap()
    };
    let all: Vec<usize> = (0..transitions.len()).collect();
    let outputs = MemberOutputs::new(ensemble.answers(&transitions.observations(&all)), 5, 4).unwrap();
    let wanted: Vec<f64> = (0..4)
        .map(|choice| {
            let costs: Vec<f64> =
                (0..transitions.len()).map(|at| outputs.discrete_cost(at, choice)).collect();
            disagreement::quantile(&costs, 0.9).unwrap()
        })
        .collect();
    assert_eq!(signal("per-choice").state().thresholds, wanted);
    assert_eq!(signal("last-choice").state().thresholds, [wanted[3]; 4]);
    // Each entry's reward follows from its own choice.
    let mut rollout = Rollout::new(transitions.observation(), 1, 1, 4);
    for entry in 0..4 {
        rollout.frames.set(rollout.entry_slot(entry), dril_envs::Frame::Vector(&[9.0, -9.0]), true);
    }
    rollout.actions = vec![0.0, 1.0, 2.0, 3.0];
    signal("per-choice").replace_rewards(&mut rollout).unwrap();
    let far = ensemble.answers(&Batch::Vectors { rows: 1, numbers: vec![9.0, -9.0] });
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
    assert_ne!(whole[0], whole[2]);
    let stopped = bench(&params, 1);
    // Two steps and one minibatch of each update can be stopped after.
    stop_often(&stopped, 8);
    assert_eq!(outputs(&stopped, &OUTPUTS), whole);
}

#[test]
fn half_of_the_demonstrated_pairs_lie_below_a_threshold_at_the_median() {
    let (ensemble, transitions) = vector_world();
    let of = |quantile: f64| {
        let params = json!({ "env": { "car-racing": {} }, "quantile": quantile });
        let params: DrilParams = serde_json::from_value(params).unwrap();
        Signal::new(&ensemble, &transitions, &params).unwrap().state().threshold
    };
    let median = of(0.5);
    let all: Vec<usize> = (0..transitions.len()).collect();
    let answers = ensemble.answers(&transitions.observations(&all));
    let outputs = MemberOutputs::new(answers, 5, 2).unwrap();
    let costs = disagreement::continuous_costs(&outputs, &transitions.actions(&all));
    assert_eq!(costs.iter().filter(|cost| **cost <= median).count(), 25);
    assert!(of(0.98) > median);
}

#[test]
fn a_step_of_cloning_lowers_its_loss_and_leaves_the_critic_alone() {
    let (_, transitions) = vector_world();
    let architecture = Architecture {
        network: Network::Mlp,
        family: PolicyFamily::Gaussian,
        observation: transitions.observation(),
        actions: transitions.action_space(),
    };
    let mut policy = Policy::new(architecture, &mut Seed(3).stream("init")).unwrap();
    let all: Vec<usize> = (0..transitions.len()).collect();
    let loss =
        |policy: &Policy| policy.validation_loss(&transitions.observations(&all), &transitions.actions(&all));
    let critic = |policy: &Policy| policy.values(&transitions.observations(&all))[7];
    let (loss_before, critic_before) = (loss(&policy), critic(&policy));
    let params = json!({ "env": { "car-racing": {} }, "bc_batch_size": 20, "bc_learning_rate": 1e-3 });
    let params: DrilParams = serde_json::from_value(params).unwrap();
    let mut cloning = Cloning::new(&policy, &transitions, all.clone(), &params, Seed(3));
    for _ in 0..30 {
        cloning.step(&mut policy).unwrap();
    }
    assert!(loss(&policy) < 0.8 * loss_before);
    assert_eq!(critic(&policy), critic_before);
    assert!(cloning.mean_loss() < loss_before);
    assert!(cloning.mean_loss().is_nan(), "nothing was learnt since");
}
