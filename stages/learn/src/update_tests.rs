//! The loss against its formula, and the order of minibatches.

use std::collections::BTreeSet;

use dril_stage_api::Seed;
use proptest::prelude::*;

use super::*;

#[test]
fn actor_critic_learns_once_from_the_whole_rollout_with_plain_advantages() {
    crate::fast::prepare();
    let settings = UpdateSettings { algorithm: Algorithm::A2c, epochs: 7, minibatches: 5, ..settings() };
    let batch = Advantages { advantages: vec![0.5; 10], returns: vec![1.0; 10] };
    let (mut update, mut stream) = (Update::new(batch), Seed(1).stream("minibatch"));
    let mut all = update.next_minibatch(&settings, &mut stream).unwrap();
    all.sort_unstable();
    assert_eq!(all, (0..10).collect::<Vec<_>>());
    assert_eq!(update.next_minibatch(&settings, &mut stream), None);
    let row = |values: [f32; 2]| Tensor::from_slice(&values);
    let samples = Samples {
        old_log_probs: row([-1.0, -2.0]),
        old_values: row([0.0, 0.0]),
        advantages: row([100.0, 100.0]),
        returns: row([3.0, 1.0]),
    };
    let losses = a2c_loss(&row([-1.0, -2.0]), &row([1.0, 2.0]), &row([0.7, 0.9]), &samples, &settings);
    let value = |tensor: &Tensor| tensor.double_value(&[]);
    // Advantages 2 and −1: −(2·(−1) + (−1)·(−2)) / 2 and (4 + 1) / 2.
    assert!((value(&losses.policy) - 0.0).abs() < 1e-6 && (value(&losses.value) - 2.5).abs() < 1e-6);
    let total = 2.5 * settings.value_coef - 0.8 * settings.entropy_coef;
    assert!((value(&losses.total) - total).abs() < 1e-6);
}

fn settings() -> UpdateSettings {
    UpdateSettings {
        algorithm: Algorithm::Ppo,
        epochs: 3,
        minibatches: 4,
        clip_range: 0.2,
        entropy_coef: 0.01,
        value_coef: 0.5,
        max_grad_norm: 0.5,
        gamma: 0.99,
        gae_lambda: 0.95,
    }
}

fn tensor(values: &[f32]) -> Tensor {
    Tensor::from_slice(values)
}

fn samples(advantages: &[f32]) -> Samples {
    Samples {
        old_log_probs: tensor(&[-1.0, -2.0]),
        old_values: tensor(&[0.5, 1.0]),
        advantages: tensor(advantages),
        returns: tensor(&[1.0, 0.0]),
    }
}

fn near(found: &Tensor, wanted: f64) {
    let found = found.double_value(&[]);
    assert!((found - wanted).abs() < 1e-6, "{found}, expected {wanted}");
}

#[test]
fn every_term_of_the_loss_equals_its_formula() {
    crate::fast::prepare();
    // Ratios e^0.1 (within ±0.2) and e^-0.5 (below); values move by 0.1 (within) and by -0.5 (beyond).
    let (log_probs, values) = (tensor(&[-0.9, -2.5]), tensor(&[0.6, 0.5]));
    let losses = ppo_loss(&log_probs, &values, &tensor(&[1.0, 3.0]), &samples(&[2.0, 1.5]), &settings());
    let (r0, r1) = (0.1_f64.exp(), (-0.5_f64).exp());
    // A positive advantage takes the smaller of r·A and clip(r)·A: here both unclipped.
    let policy = -(r0 * 2.0 + r1 * 1.5) / 2.0;
    // The larger error: (0.6−1)², and (1−0.2−0)² against (0.5−0)².
    let value = 0.5 * (0.4_f64.powi(2) + 0.8_f64.powi(2)) / 2.0;
    near(&losses.policy, policy);
    near(&losses.value, value);
    near(&losses.entropy, 2.0);
    near(&losses.total, policy + 0.5 * value - 0.01 * 2.0);
    near(&losses.clip_fraction, 0.5);
    near(&losses.approx_kl, ((r0 - 1.0 - 0.1) + (r1 - 1.0 + 0.5)) / 2.0);
}

#[test]
fn a_ratio_beyond_the_clip_in_the_advantages_direction_has_no_gradient() {
    crate::fast::prepare();
    let gradient = |advantages: &[f32]| {
        let log_probs = tensor(&[-0.5, -2.0]).set_requires_grad(true);
        let losses = ppo_loss(
            &log_probs,
            &tensor(&[0.5, 1.0]),
            &tensor(&[0.0, 0.0]),
            &samples(advantages),
            &settings(),
        );
        Tensor::run_backward(&[losses.policy], &[log_probs], false, false).remove(0).double_value(&[0])
    };
    assert_eq!(gradient(&[1.0, 0.0]), 0.0);
    assert!(gradient(&[-1.0, 0.0]) > 0.0, "the way back is open");
}

proptest! {
    #[test]
    fn each_pass_uses_every_entry_at_most_once_and_leaves_out_less_than_a_minibatch_each(
        entries in 4_usize..60, minibatches in 1_u64..5
    ) {
        let settings = UpdateSettings { minibatches, ..settings() };
        let mut stream = Seed(1).stream("minibatch");
        let advantages = vec![1.0; entries];
        let mut update = Update::new(Advantages { returns: advantages.clone(), advantages });
        let size = entries / minibatches as usize;
        for _ in 0..settings.epochs {
            let mut seen = BTreeSet::new();
            for _ in 0..entries / size {
                let minibatch = update.next_minibatch(&settings, &mut stream).unwrap();
                prop_assert_eq!(minibatch.len(), size);
                seen.extend(minibatch);
            }
            prop_assert_eq!(seen.len(), entries / size * size);
            prop_assert!(seen.iter().all(|&entry| entry < entries));
        }
        prop_assert!(update.next_minibatch(&settings, &mut stream).is_none());
    }
}

#[test]
fn passes_have_different_orders() {
    let mut stream = Seed(1).stream("minibatch");
    let mut update = Update::new(Advantages { advantages: vec![0.0; 40], returns: vec![0.0; 40] });
    let passes: Vec<Vec<usize>> =
        (0..12).filter_map(|_| update.next_minibatch(&settings(), &mut stream)).collect();
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
