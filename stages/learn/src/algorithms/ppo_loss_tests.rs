//! The losses by hand, and bit by bit.

use dril_stage_api::Seed;
use rand::RngExt;

use super::*;

#[path = "ppo_oracle_tests.rs"]
mod oracle_tests;

const PARAMS: UpdateParams = UpdateParams {
    n_epochs: 1,
    n_minibatches: 1,
    clip_range: 0.2,
    vf_coef: 0.5,
    ent_coef: 0.01,
    max_grad_norm: 0.5,
    gamma: 0.99,
    gae_lambda: 0.95,
};

type Case = LossInputs;

impl Case {
    /// Ratios and values around the borders of the clip range, and every kind of corner among them.
    fn random(count: usize, seed: u64) -> Self {
        let mut stream = Seed(seed).stream("case");
        let mut case = Self::default();
        for index in 0..count {
            let mut number = || 2.0 * stream.random::<f64>() - 1.0;
            let (old, moved) = (3.0 * number(), 0.5 * number());
            let (old_value, value_moved) = (2.0 * number() as f32, 0.5 * number() as f32);
            case.old_log_probs.push(old);
            // Some ratios are 1 exactly.
            case.log_probs.push(if index % 5 == 0 { old } else { old + moved });
            case.old_values.push(old_value);
            case.values.push(if index % 7 == 0 { old_value } else { old_value + value_moved });
            // Some advantages are 0: both arguments of the minimum are then equal outside the range.
            case.advantages.push(if index % 6 == 0 { 0.0 } else { 2.0 * number() as f32 });
            case.returns.push(if index % 11 == 0 { case.values[index] } else { 2.0 * number() as f32 });
            case.entropies.push(number());
        }
        case
    }
}

fn near(found: f64, wanted: f64) {
    assert!((found - wanted).abs() < 1e-6, "{found}, expected {wanted}");
}

fn two() -> Case {
    Case {
        log_probs: vec![-0.9, -2.5],
        entropies: vec![1.0, 3.0],
        values: vec![0.6, 0.5],
        old_log_probs: vec![-1.0, -2.0],
        old_values: vec![0.5, 1.0],
        advantages: vec![2.0, 1.5],
        returns: vec![1.0, 0.0],
    }
}

#[test]
fn every_term_of_the_loss_equals_its_formula() {
    // Ratios e^0.1 (within ±0.2) and e^-0.5 (below); values move by 0.1 (within) and by -0.5 (beyond).
    let (terms, gradients) = ppo_loss(&two(), &PARAMS);
    let (r0, r1) = (0.1_f64.exp(), (-0.5_f64).exp());
    // A positive advantage takes the smaller of r·A and clip(r)·A: here both unclipped.
    let policy = -(r0 * 2.0 + r1 * 1.5) / 2.0;
    // The larger error: (0.6−1)², and (1−0.2−0)² against (0.5−0)².
    let value = 0.5 * (0.4_f64 * 0.4 + 0.8 * 0.8) / 2.0;
    near(terms.policy, policy);
    near(terms.value, value);
    near(terms.entropy, 2.0);
    near(terms.total, policy + 0.5 * value - 0.01 * 2.0);
    near(terms.clip_fraction, 0.5);
    near(terms.approx_kl, ((r0 - 1.0 - 0.1) + (r1 - 1.0 + 0.5)) / 2.0);
    near(gradients.log_probs[0], -r0 * 2.0 / 2.0);
    near(gradients.log_probs[1], -r1 * 1.5 / 2.0);
    // ½ · vf_coef · ½ · 2 (0.6 − 1); the clipped value has none.
    near(gradients.values[0], 0.5 * 0.5 * 2.0 * -0.4 / 2.0);
    assert_eq!(gradients.values[1], 0.0);
    near(gradients.entropy, -0.01 / 2.0);
}

#[test]
fn a_ratio_beyond_the_clip_in_the_advantages_direction_has_no_gradient() {
    let gradient = |advantage: f32| {
        let case = Case { log_probs: vec![-0.5, -2.0], advantages: vec![advantage, 0.0], ..two() };
        ppo_loss(&case, &PARAMS).1.log_probs[0]
    };
    assert_eq!(gradient(1.0), 0.0);
    assert!(gradient(-1.0) > 0.0, "the way back is open");
}

#[test]
fn actor_critic_takes_its_advantages_from_the_values_of_now() {
    let case = Case {
        log_probs: vec![-1.0, -2.0],
        old_log_probs: vec![-1.0, -2.0],
        values: vec![1.0, 2.0],
        returns: vec![3.0, 1.0],
        entropies: vec![0.7, 0.9],
        ..two()
    };
    let (terms, gradients) = a2c_loss(&case, &PARAMS);
    // Advantages 2 and −1: −(2·(−1) + (−1)·(−2)) / 2 and (4 + 1) / 2.
    near(terms.policy, 0.0);
    near(terms.value, 2.5);
    near(terms.total, 2.5 * PARAMS.vf_coef - 0.8 * PARAMS.ent_coef);
    assert_eq!((terms.approx_kl, terms.clip_fraction), (0.0, 0.0));
    assert_eq!(gradients.log_probs, [-1.0, 0.5]);
    assert_eq!(gradients.values, [-1.0, 0.5]);
}

#[test]
fn a_number_that_is_none_reaches_the_total() {
    for part in 0..3 {
        let mut case = two();
        match part {
            0 => case.log_probs[0] = f64::NAN,
            1 => case.values[1] = f32::NAN,
            _ => case.entropies[0] = f64::NAN,
        }
        assert!(ppo_loss(&case, &PARAMS).0.total.is_nan(), "{part}");
        assert!(a2c_loss(&case, &PARAMS).0.total.is_nan(), "{part}");
    }
}

#[test]
fn every_bit_is_the_same_on_every_machine() {
    let case = Case::random(512, 3);
    let mut hasher = blake3::Hasher::new();
    for loss in [ppo_loss, a2c_loss] {
        let (terms, gradients) = loss(&case, &PARAMS);
        for value in
            [terms.total, terms.approx_kl].iter().chain(&gradients.log_probs).chain(&gradients.values)
        {
            hasher.update(&value.to_le_bytes());
        }
    }
    assert_eq!(&hasher.finalize().to_hex()[..16], "b60ce716ba8901f1");
}
