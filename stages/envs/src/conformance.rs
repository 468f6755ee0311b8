//! What every environment with two continuous actions has to do; each game runs these tests on itself by
//! [`conformance_tests!`].

use proptest::prelude::*;
use proptest::test_runner::{TestCaseError, TestRunner};

use crate::{Env, EnvError, EnvSnapshot, Outcome};

/// Declares the conformance tests for environments made by `$new`, a function of the time limit.
macro_rules! conformance_tests {
    ($new:expr) => {
        mod conformance {
            use super::*;
            use crate::conformance as check;

            #[test]
            fn the_time_limit_truncates_an_episode_without_a_terminal_state() {
                check::time_limit(&mut $new(3));
            }

            #[test]
            fn nan_is_refused_with_the_dimension_and_other_numbers_are_clamped() {
                check::actions(&mut $new(10));
            }

            #[test]
            fn stepping_after_the_end_is_an_error_until_the_next_reset() {
                check::end(&mut $new(1));
            }

            #[test]
            fn one_seed_gives_one_episode_and_another_seed_another() {
                check::seeds(|| $new(100));
            }

            #[test]
            fn a_restored_episode_continues_bit_identically() {
                check::restore(|| $new(1000));
            }

            #[test]
            fn an_impossible_snapshot_is_refused() {
                check::snapshots(&mut $new(2));
            }

            #[test]
            fn images_have_the_requested_size_or_are_refused() {
                check::rendering(&mut $new(10));
            }
        }
    };
}

pub(crate) use conformance_tests;

pub(crate) fn time_limit(env: &mut impl Env) {
    env.reset(1).unwrap();
    let outcomes: Vec<_> = (0..3).map(|_| env.step(&[0.0, 0.0]).unwrap().outcome).collect();
    assert_eq!(outcomes, [Outcome::Running, Outcome::Running, Outcome::TimeLimit]);
    assert!(Outcome::TimeLimit.ended() && !Outcome::TimeLimit.terminal());
}

pub(crate) fn actions(env: &mut impl Env) {
    assert_eq!(env.step(&[0.0, 0.0]), Err(EnvError::NotStarted));
    env.reset(0).unwrap();
    assert_eq!(env.step(&[0.0, f32::NAN]), Err(EnvError::ActionNan { dimension: 1 }));
    assert_eq!(env.step(&[0.0]), Err(EnvError::ActionLength { seen: 1, expected: 2 }));
    assert_eq!(env.step(&[0.0; 3]), Err(EnvError::ActionLength { seen: 3, expected: 2 }));
    assert!(env.snapshot().actions.is_empty(), "a refused action is no step");
    env.step(&[f32::INFINITY, -7.0]).unwrap();
    assert_eq!(env.snapshot().actions, [1.0, -1.0]);
}

pub(crate) fn end(env: &mut impl Env) {
    env.reset(0).unwrap();
    env.step(&[0.0, 0.0]).unwrap();
    assert_eq!(env.step(&[0.0, 0.0]), Err(EnvError::Over { length: 1 }));
    env.reset(0).unwrap();
    assert!(env.step(&[0.0, 0.0]).is_ok());
}

pub(crate) fn seeds<E: Env>(new: impl Fn() -> E) {
    let frame = |seed: u64| {
        let mut env = new();
        // The episode before does not matter.
        env.reset(seed ^ 5).unwrap();
        env.step(&[1.0, 1.0]).unwrap();
        env.reset(seed).unwrap();
        env.step(&[0.5, 1.0]).unwrap();
        env.frame().to_owned()
    };
    assert_eq!(frame(8), frame(8));
    assert_ne!(frame(8), frame(9));
}

pub(crate) fn restore<E: Env>(new: impl Fn() -> E) {
    let before = prop::collection::vec(prop::array::uniform2(-1.5f32..1.5), 0..40);
    let after = prop::collection::vec(prop::array::uniform2(-1.0f32..1.0), 1..10);
    let mut runner = TestRunner::new(ProptestConfig::with_cases(8));
    let result = runner.run(&(any::<u64>(), before, after), |(seed, before, after)| {
        let fail = |error: EnvError| TestCaseError::fail(error.to_string());
        let (mut one, mut other) = (new(), new());
        one.reset(seed).map_err(fail)?;
        for action in &before {
            one.step(action).map_err(fail)?;
        }
        other.restore(&one.snapshot()).map_err(fail)?;
        prop_assert_eq!(one.frame(), other.frame());
        for action in &after {
            prop_assert_eq!(one.step(action), other.step(action));
            prop_assert_eq!(one.frame(), other.frame());
        }
        Ok(())
    });
    result.unwrap();
}

pub(crate) fn snapshots(env: &mut impl Env) {
    let mut refused = |actions: Vec<f32>, part: &str| {
        let error = env.restore(&EnvSnapshot { seed: Some(0), actions }).unwrap_err().to_string();
        assert!(error.contains(part), "{error}");
    };
    refused(vec![0.0; 6], "3 actions, but the episode ends after 2");
    refused(vec![0.0; 3], "1 values, expected 2");
    refused(vec![f32::NAN, 0.0], "NaN");
    env.restore(&EnvSnapshot::default()).unwrap();
    assert_eq!(env.step(&[0.0, 0.0]), Err(EnvError::NotStarted));
}

pub(crate) fn rendering(env: &mut impl Env) {
    assert_eq!(env.render(10, 10).unwrap_err(), EnvError::NotStarted);
    env.reset(0).unwrap();
    let image = env.render(40, 30).unwrap();
    assert_eq!((image.width, image.height, image.rgb.len()), (40, 30, 40 * 30 * 3));
    assert!(image.to_png().unwrap().starts_with(b"\x89PNG"));
    assert!(env.render(0, 10).is_err() && env.render(10, 100_000).is_err());
}
