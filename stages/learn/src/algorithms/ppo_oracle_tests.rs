//! The losses against libtorch's autograd in double precision.

use tch::{Kind, Tensor};

use super::*;

/// What libtorch makes of a case: policy, value, entropy, total, clip fraction, divergence; and the gradients of the
/// total for log-densities, values and entropies.
fn by_torch(case: &Case, a2c: bool) -> ([f64; 6], [Vec<f64>; 3]) {
    let single = |values: &[f32]| Tensor::from_slice(values).to_kind(Kind::Double);
    let log_probs = Tensor::from_slice(&case.log_probs).set_requires_grad(true);
    let values = single(&case.values).set_requires_grad(true);
    let entropies = Tensor::from_slice(&case.entropies).set_requires_grad(true);
    let (advantages, returns) = (single(&case.advantages), single(&case.returns));
    let (old_values, clip) = (single(&case.old_values), PARAMS.clip_range);
    let log_ratio: Tensor = &log_probs - Tensor::from_slice(&case.old_log_probs);
    let ratio = log_ratio.exp();
    let mean = |tensor: Tensor| tensor.mean(Kind::Double);
    let (policy, value, clip_fraction) = if a2c {
        let advantages: Tensor = &returns - &values;
        let policy = -mean(advantages.detach() * &log_probs);
        (policy, mean(advantages.square()), Tensor::from(0.0))
    } else {
        let plain: Tensor = &ratio * &advantages;
        let clipped: Tensor = ratio.clamp(1.0 - clip, 1.0 + clip) * &advantages;
        let clipped_values: Tensor = &old_values + (&values - &old_values).clamp(-clip, clip);
        let errors = (&values - &returns).square();
        let clipped_errors = (clipped_values - &returns).square();
        let outside: Tensor = &ratio - 1.0;
        let outside = mean(outside.abs().gt(clip).to_kind(Kind::Double));
        (-mean(plain.minimum(&clipped)), mean(errors.maximum(&clipped_errors)) * 0.5, outside)
    };
    let entropy = entropies.mean(Kind::Double);
    let total = &policy + &value * PARAMS.vf_coef - &entropy * PARAMS.ent_coef;
    let divergence = mean(&ratio - 1.0 - &log_ratio);
    let leaves = [&log_probs, &values, &entropies];
    let gradients = Tensor::run_backward(&[&total], &leaves, true, false);
    let gradients = [0, 1, 2].map(|at| Vec::<f64>::try_from(&gradients[at].contiguous()).unwrap());
    let terms = [&policy, &value, &entropy, &total, &clip_fraction, &divergence];
    (terms.map(|term| term.double_value(&[])), gradients)
}

#[test]
fn terms_and_gradients_equal_those_of_libtorch_in_double_precision() {
    for seed in 0..20 {
        let case = Case::random(154, seed);
        for a2c in [false, true] {
            let loss = if a2c { a2c_loss } else { ppo_loss };
            let (terms, gradients) = loss(&case, &PARAMS);
            let (wanted, [log_probs, values, entropies]) = by_torch(&case, a2c);
            let LossTerms { policy, value, entropy, total, clip_fraction, approx_kl } = terms;
            let found = [policy, value, entropy, total, clip_fraction, approx_kl];
            let near = |(found, wanted): (&f64, &f64)| (found - wanted).abs() < 1e-14 * (1.0 + wanted.abs());
            assert!(found.iter().zip(&wanted).all(near), "{a2c}: {found:?}, expected {wanted:?}");
            assert!(gradients.log_probs.iter().zip(&log_probs).all(near), "{a2c} {seed}");
            assert!(gradients.values.iter().zip(&values).all(near), "{a2c} {seed}");
            assert!(entropies.iter().all(|wanted| near((&gradients.entropy, wanted))));
        }
    }
}
