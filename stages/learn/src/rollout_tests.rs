//! Advantages against their closed form, and what a sampler records.

use dril_envs::Frame;
use proptest::prelude::*;

use super::*;
use crate::net::Network;
use crate::policy::{Architecture, PolicyFamily};
use crate::test_env::Echo;

const OBSERVATION: Observation = Observation::Vector { len: 1 };

/// The closed form: the sum over the rest of the episode of (γλ)^k δ, with δ = r + γ V(s′) − V(s).
fn closed_form(rollout: &Rollout, last: &[f32], gamma: f64, lambda: f64, entry: usize) -> f64 {
    let (envs, env) = (rollout.envs, entry % rollout.envs);
    let (mut sum, mut factor) = (0.0, 1.0);
    for t in entry / envs..rollout.steps {
        let at = t * envs + env;
        let next = if rollout.ends[at] {
            rollout.cut_values[at]
        } else if t + 1 == rollout.steps {
            last[env]
        } else {
            rollout.values[at + envs]
        };
        sum += factor
            * (f64::from(rollout.rewards[at]) + gamma * f64::from(next) - f64::from(rollout.values[at]));
        if rollout.ends[at] {
            break;
        }
        factor *= gamma * lambda;
    }
    sum
}

fn numbers(count: usize) -> impl Strategy<Value = Vec<f32>> {
    prop::collection::vec(-3.0_f32..3.0, count)
}

proptest! {
    #[test]
    fn advantages_equal_their_closed_form(
        rewards in numbers(14), values in numbers(14), cuts in numbers(14), last in numbers(2),
        ends in prop::collection::vec(prop::bool::weighted(0.3), 14), gamma in 0.0..=1.0_f64, lambda in 0.0..=1.0_f64,
    ) {
        let mut rollout = Rollout::new(OBSERVATION, 1, 2, 7);
        (rollout.rewards, rollout.values, rollout.cut_values, rollout.ends) = (rewards, values, cuts, ends);
        let found = rollout.advantages(&last, gamma, lambda);
        for entry in 0..14 {
            let wanted = closed_form(&rollout, &last, gamma, lambda, entry);
            prop_assert!((f64::from(found.advantages[entry]) - wanted).abs() < 1e-4);
            prop_assert_eq!(found.returns[entry], found.advantages[entry] + rollout.values[entry]);
        }
    }
}

fn policy() -> Policy {
    crate::fast::prepare();
    let architecture = Architecture {
        network: Network::Mlp,
        family: PolicyFamily::Gaussian,
        observation: OBSERVATION,
        actions: 1,
    };
    Policy::new(architecture, &mut Seed(1).stream("init")).unwrap()
}

fn sampled(outcome: Outcome, bootstrap_time_limits: bool) -> (Policy, Rollout, Vec<f32>) {
    let policy = policy();
    let settings = SamplerSettings {
        mean_action_probability: 0.0,
        bootstrap_time_limits,
        normalize_observations: false,
    };
    let mut sampler = Sampler::new(Echo::several(2, 3, outcome), Seed(5), settings, None);
    let mut rollout = Rollout::new(OBSERVATION, 1, 2, 7);
    sampler.start(&mut rollout).unwrap();
    let mut last_seen = Vec::new();
    for t in 0..7 {
        for episode in sampler.step(&policy, &mut rollout, t).unwrap() {
            assert_eq!((episode.length, t % 3), (3, 2));
            if let Frame::Vector(seen) = episode.last_frame.as_frame() {
                last_seen.extend_from_slice(seen);
            }
        }
    }
    (policy, rollout, last_seen)
}

#[test]
fn an_entry_holds_what_was_seen_done_and_said_at_its_step() {
    let (policy, rollout, _) = sampled(Outcome::Finished, true);
    assert_eq!(rollout.ends.iter().filter(|&&end| end).count(), 4);
    for entry in 0..rollout.len() {
        let seen = rollout.frames.gather(&[rollout.entry_slot(entry)]);
        let forward = tch::no_grad(|| policy.forward(&seen));
        let sample = Tensor::from_slice(&rollout.samples[entry..=entry]).view([1, 1]);
        let log_prob = forward.distribution.log_prob(&sample).double_value(&[0]);
        assert!((log_prob - f64::from(rollout.log_probs[entry])).abs() < 1e-5);
        assert!((forward.values.double_value(&[0]) - f64::from(rollout.values[entry])).abs() < 1e-5);
        let number = seen.double_value(&[0, 0]);
        let reward = 1.0 - (f64::from(rollout.actions[entry]).clamp(-1.0, 1.0) - number).abs();
        assert!((reward - f64::from(rollout.rewards[entry])).abs() < 1e-6);
    }
}

#[test]
fn after_a_time_limit_stands_the_value_of_the_last_state_and_after_a_real_end_nothing() {
    let (policy, rollout, seen) = sampled(Outcome::TimeLimit, true);
    let cut: Vec<usize> = (0..rollout.len()).filter(|&entry| rollout.ends[entry]).collect();
    for (&entry, seen) in cut.iter().zip(seen) {
        let value =
            tch::no_grad(|| policy.values(&Tensor::from_slice(&[seen]).view([1, 1]))).double_value(&[0]);
        assert!((value - f64::from(rollout.cut_values[entry])).abs() < 1e-6 && value != 0.0);
    }
    assert!(sampled(Outcome::Finished, true).1.cut_values.iter().all(|&value| value == 0.0));
    assert!(sampled(Outcome::TimeLimit, false).1.cut_values.iter().all(|&value| value == 0.0));
}

#[test]
fn the_next_rollout_begins_where_the_last_one_ended() {
    let (_, mut rollout, _) = sampled(Outcome::Finished, true);
    let last = rollout.observations(7);
    rollout.begin_next();
    assert_eq!(rollout.observations(0), last);
}
