//! Advantages against their closed form, and the order of minibatches. The losses' tests are in [`losses`].

use std::collections::BTreeSet;

use dril_envs::ObservationSpace;
use dril_stage_api::Seed;
use proptest::prelude::*;

use super::*;

#[path = "ppo_loss_tests.rs"]
mod losses;

#[test]
fn actor_critic_learns_once_from_the_whole_rollout_with_plain_advantages() {
    let settings = (Algorithm::A2c, &UpdateParams { n_epochs: 7, n_minibatches: 5, ..params() });
    let batch = Advantages { advantages: vec![0.5; 10], returns: vec![1.0; 10] };
    let (mut update, mut stream) = (Update::new(batch), Seed(1).stream("minibatch"));
    let mut all = update.next_minibatch(settings, &mut stream).unwrap();
    all.sort_unstable();
    assert_eq!(all, (0..10).collect::<Vec<_>>());
    assert_eq!(update.next_minibatch(settings, &mut stream), None);
}

fn params() -> UpdateParams {
    UpdateParams { n_epochs: 3, n_minibatches: 4, ent_coef: 0.01, ..UpdateParams::default() }
}

proptest! {
    #[test]
    fn each_pass_uses_every_entry_at_most_once_and_leaves_out_less_than_a_minibatch_each(
        entries in 4_usize..60, n_minibatches in 1_u64..5
    ) {
        let params = UpdateParams { n_minibatches, ..params() };
        let mut stream = Seed(1).stream("minibatch");
        let advantages = vec![1.0; entries];
        let mut update = Update::new(Advantages { returns: advantages.clone(), advantages });
        let size = entries / n_minibatches as usize;
        for _ in 0..params.n_epochs {
            let mut seen = BTreeSet::new();
            for _ in 0..entries / size {
                let minibatch = update.next_minibatch((Algorithm::Ppo, &params), &mut stream).unwrap();
                prop_assert_eq!(minibatch.len(), size);
                seen.extend(minibatch);
            }
            prop_assert_eq!(seen.len(), entries / size * size);
            prop_assert!(seen.iter().all(|&entry| entry < entries));
        }
        prop_assert!(update.next_minibatch((Algorithm::Ppo, &params), &mut stream).is_none());
    }
}

#[test]
fn passes_have_different_orders() {
    let mut stream = Seed(1).stream("minibatch");
    let mut update = Update::new(Advantages { advantages: vec![0.0; 40], returns: vec![0.0; 40] });
    let passes: Vec<Vec<usize>> =
        (0..12).filter_map(|_| update.next_minibatch((Algorithm::Ppo, &params()), &mut stream)).collect();
    assert_ne!(passes[0], passes[4]);
}

#[test]
fn advantages_are_normalized_with_the_sample_deviation() {
    let normalized = normalize(&[1.0, 2.0, 3.0, 6.0]);
    // Mean 3, squared deviations 4 + 1 + 0 + 9 over 3.
    let std = (14.0_f64 / 3.0).sqrt() + 1e-5;
    for (found, deviation) in normalized.iter().zip([-2.0, -1.0, 0.0, 3.0]) {
        assert!((f64::from(*found) - deviation / std).abs() < 1e-6);
    }
    assert_eq!(normalize(&[5.0, 5.0]), [0.0, 0.0]);
}

#[test]
fn explained_variance_is_one_for_a_perfect_critic_and_zero_for_a_constant_one() {
    assert_eq!(explained_variance(&[1.0, 2.0, 4.0], &[1.0, 2.0, 4.0]), 1.0);
    assert_eq!(explained_variance(&[7.0, 7.0, 7.0], &[1.0, 2.0, 4.0]), 0.0);
    assert!(explained_variance(&[1.0], &[1.0]).is_nan());
}

/// The closed form: the sum over the rest of the episode of (γλ)^k δ, with δ = r + γ V(s′) − V(s).
fn closed_form(rollout: &Rollout, last: &[f32], gamma: f64, lambda: f64, entry: usize) -> f64 {
    let (envs, env) = (rollout.envs, entry % rollout.envs);
    let (mut sum, mut factor) = (0.0, 1.0);
    for t in entry / envs..rollout.steps {
        let at = t * envs + env;
        let next = if rollout.dones[at] {
            rollout.bootstrap_values[at]
        } else if t + 1 == rollout.steps {
            last[env]
        } else {
            rollout.values[at + envs]
        };
        sum += factor
            * (f64::from(rollout.rewards[at]) + gamma * f64::from(next) - f64::from(rollout.values[at]));
        if rollout.dones[at] {
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
        dones in prop::collection::vec(prop::bool::weighted(0.3), 14), gamma in 0.0..=1.0_f64, lambda in 0.0..=1.0_f64,
    ) {
        let mut rollout = Rollout::new(ObservationSpace::Vector { len: 1 }, 1, 2, 7);
        (rollout.rewards, rollout.values, rollout.bootstrap_values, rollout.dones) = (rewards, values, cuts, dones);
        let found = gae(&rollout, &last, gamma, lambda);
        for entry in 0..14 {
            let wanted = closed_form(&rollout, &last, gamma, lambda, entry);
            prop_assert!((f64::from(found.advantages[entry]) - wanted).abs() < 1e-4);
            prop_assert_eq!(found.returns[entry], found.advantages[entry] + rollout.values[entry]);
        }
    }
}
