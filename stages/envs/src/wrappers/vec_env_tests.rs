//! Several environments: results follow from seeds and actions, never from threads.

use super::*;
use crate::CarRacingConfig;
use proptest::prelude::*;

fn config(time_limit: u32) -> EnvConfig {
    EnvConfig::CarRacing(CarRacingConfig { time_limit, ..CarRacingConfig::default() })
}

/// Steps `envs` for a while and notes all that it shows.
fn play(envs: &mut VecEnv, steps: usize, next: &mut u64) -> Vec<(VecStep, OwnedFrame)> {
    let mut seen = Vec::new();
    for step in 0..steps {
        let actions: Vec<f32> =
            (0..envs.len() * 2).map(|i| ((step * 7 + i * 3) as f32 * 0.37).sin()).collect();
        let results = envs
            .step(&actions, |_| {
                *next += 1;
                *next
            })
            .unwrap()
            .to_vec();
        seen.extend(results.into_iter().enumerate().map(|(i, step)| (step, envs.frame(i).to_owned())));
    }
    seen
}

#[test]
fn results_are_the_same_for_every_number_of_threads() {
    let run = |threads| {
        let mut envs = VecEnv::new(&config(9), 5, threads).unwrap();
        envs.reset_all(|i| i as u64).unwrap();
        play(&mut envs, 25, &mut 100)
    };
    let serial = run(1);
    for threads in [2, 3, 8] {
        assert_eq!(run(threads), serial, "{threads} threads");
    }
}

#[test]
fn an_ended_episode_is_reported_whole_and_the_next_one_begins() {
    let mut envs = VecEnv::new(&config(4), 2, 1).unwrap();
    envs.reset_all(|i| i as u64).unwrap();
    let mut total = 0.0;
    for _ in 0..3 {
        total += envs.step(&[0.0, 1.0, 0.0, 0.0], |_| 9).unwrap()[0].reward;
    }
    let before = envs.frame(0).to_owned();
    let mut asked = Vec::new();
    let results = envs.step(&[0.0, 1.0, 0.0, 0.0], |i| {
        asked.push(i);
        77 + i as u64
    });
    let [first, second] = <[VecStep; 2]>::try_from(results.unwrap().to_vec()).unwrap();
    assert_eq!(asked, [0, 1]);
    assert_eq!((first.outcome, second.outcome), (Outcome::TimeLimit, Outcome::TimeLimit));
    let episode = first.finished.unwrap();
    assert_eq!((episode.seed, episode.length), (0, 4));
    assert!((episode.score - (total + first.reward)).abs() < 1e-12);
    let mut fresh = config(4).build().unwrap();
    fresh.reset(77).unwrap();
    assert_eq!(envs.frame(0), fresh.frame());
    assert_ne!(episode.last_frame.as_frame(), envs.frame(0));
    assert_ne!(episode.last_frame, before);
    assert_eq!(envs.seed(1), 78);
}

#[test]
fn staggered_first_episodes_end_one_after_the_other_and_later_ones_at_the_limit() {
    let mut envs = VecEnv::new(&config(6), 3, 1).unwrap();
    envs.stagger(6);
    envs.reset_all(|i| i as u64).unwrap();
    let seen = play(&mut envs, 14, &mut 100);
    let ends = |env: usize| -> Vec<(usize, usize)> {
        let steps = seen.iter().skip(env).step_by(3).enumerate();
        steps.filter_map(|(at, (step, _))| Some((at + 1, step.finished.as_ref()?.length))).collect()
    };
    assert_eq!(ends(0), [(2, 2), (8, 6), (14, 6)]);
    assert_eq!(ends(1), [(4, 4), (10, 6)]);
    assert_eq!(ends(2), [(6, 6), (12, 6)]);
    assert!(seen.iter().all(|(step, _)| !step.outcome.ended() || step.outcome == Outcome::TimeLimit));
    envs.stagger(usize::MAX);
    envs.reset_all(|i| i as u64).unwrap();
    let first = play(&mut envs, 6, &mut 100);
    assert!(
        first[15..].iter().all(|(step, _)| step.finished.as_ref().unwrap().length == 6),
        "nothing is cut"
    );
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(4))]
    #[test]
    fn a_restored_snapshot_continues_as_if_nothing_had_happened(before in 0usize..12, after in 1usize..8) {
        let mut envs = VecEnv::new(&config(6), 3, 1).unwrap();
        envs.stagger(5);
        envs.reset_all(|i| 40 + i as u64).unwrap();
        let mut next = 1000;
        play(&mut envs, before, &mut next);
        let saved = serde_json::to_string(&envs.snapshot()).unwrap();
        let mut resumed = VecEnv::new(&config(6), 3, 2).unwrap();
        resumed.restore(&serde_json::from_str(&saved).unwrap()).unwrap();
        let frames = |envs: &VecEnv| (0..3).map(|i| envs.frame(i).to_owned()).collect::<Vec<_>>();
        prop_assert_eq!(frames(&resumed), frames(&envs));
        prop_assert_eq!(play(&mut resumed, after, &mut next.clone()), play(&mut envs, after, &mut next));
    }
}

#[test]
fn wrong_counts_are_refused_with_what_was_expected() {
    let error = VecEnv::new(&config(6), 0, 1).err().unwrap();
    assert_eq!(error.to_string(), "`envs`: 0, expected at least 1");
    let mut envs = VecEnv::new(&config(6), 2, 1).unwrap();
    envs.reset_all(|_| 0).unwrap();
    let error = envs.step(&[0.0; 3], |_| 0).unwrap_err();
    assert_eq!(error, EnvError::ActionLength { seen: 3, expected: 4 });
    let error = envs.step(&[0.0, 0.0, 0.0, f32::NAN], |_| 0).unwrap_err().to_string();
    assert!(error.starts_with("environment 1: action dimension 1 is NaN"), "{error}");
    let one = VecEnv::new(&config(6), 1, 1).unwrap().snapshot();
    assert!(envs.restore(&one).unwrap_err().to_string().contains("1 environments, expected 2"));
}
