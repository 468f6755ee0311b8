//! What a sampler records.

use dril_envs::{ActionSpace, Frame};
use dril_kinds::{Network, PolicyFamily};

use super::*;
use crate::policy::{Architecture, Parts};
use crate::test_env::Echo;

const OBSERVATION: ObservationSpace = ObservationSpace::Vector { len: 1 };

fn policy() -> Policy {
    let architecture = Architecture {
        network: Network::Mlp,
        family: PolicyFamily::Gaussian,
        observation: OBSERVATION,
        actions: ActionSpace::Continuous { dims: 1 },
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
    assert_eq!(rollout.dones.iter().filter(|&&end| end).count(), 4);
    for entry in 0..rollout.len() {
        let seen = rollout.frames.gather(&[rollout.entry_slot(entry)]);
        let answers = policy.infer(&seen, Parts::Both);
        let log_prob = policy.row(&answers, 0).log_prob(&rollout.samples[entry..=entry]);
        assert_eq!(log_prob as f32, rollout.log_probs[entry]);
        assert_eq!(answers.values[0], rollout.values[entry]);
        let Batch::Vectors { numbers, .. } = seen else { panic!("vectors") };
        let number = f64::from(numbers[0]);
        let reward = 1.0 - (f64::from(rollout.actions[entry]).clamp(-1.0, 1.0) - number).abs();
        assert!((reward - f64::from(rollout.rewards[entry])).abs() < 1e-6);
    }
}

#[test]
fn after_a_time_limit_stands_the_value_of_the_last_state_and_after_a_real_end_nothing() {
    let (policy, rollout, seen) = sampled(Outcome::TimeLimit, true);
    let cut: Vec<usize> = (0..rollout.len()).filter(|&entry| rollout.dones[entry]).collect();
    for (&entry, seen) in cut.iter().zip(seen) {
        let value = policy.values(&Batch::Vectors { rows: 1, numbers: vec![seen] })[0];
        assert!(value == rollout.bootstrap_values[entry] && value != 0.0);
    }
    assert!(sampled(Outcome::Finished, true).1.bootstrap_values.iter().all(|&value| value == 0.0));
    assert!(sampled(Outcome::TimeLimit, false).1.bootstrap_values.iter().all(|&value| value == 0.0));
}

#[test]
fn the_next_rollout_begins_where_the_last_one_ended() {
    let (_, mut rollout, _) = sampled(Outcome::Finished, true);
    let last = rollout.observations(7);
    rollout.begin_next();
    assert_eq!(rollout.observations(0), last);
}
