//! Lists of episodes, in a world of one number.

use dril_envs::{ActionSpace, ObservationSpace, Outcome};
use dril_kinds::{Network, PolicyFamily};

use super::*;
use crate::policy::Architecture;
use crate::test_env::Echo;

fn policy(family: PolicyFamily) -> Policy {
    let observation = ObservationSpace::Vector { len: 1 };
    let actions = ActionSpace::Continuous { dims: 1 };
    let architecture = Architecture { network: Network::Mlp, family, observation, actions };
    Policy::new(architecture, &mut Seed(1).stream("init")).unwrap()
}

fn play(mode: Mode, episodes: usize) -> Play {
    Play { mode, mean_action_probability: 0.0, first_seed: 40, episodes, record: true }
}

fn played(policy: &Policy, play: Play) -> Vec<PlayedEpisode> {
    let envs = (0..WIDTH).map(|row| Box::new(Echo::new(3 + row % 2, Outcome::Finished)) as Box<dyn Env>);
    let mut player = Player::with(policy, envs.collect(), play, Seed(9));
    let mut all = Vec::new();
    while let Some(ended) = player.step().unwrap() {
        all.extend(ended);
    }
    all.sort_by_key(|played| played.index);
    all
}

/// The mean actions for these numbers.
fn means(policy: &Policy, numbers: &[f32]) -> Vec<f32> {
    let answers =
        policy.infer(&Batch::Vectors { rows: numbers.len(), numbers: numbers.to_vec() }, Parts::Actor);
    let mean = |row| {
        let mut sample = [0.0];
        policy.row(&answers, row).mean(&mut sample);
        to_action(policy.architecture().family, sample[0])
    };
    (0..numbers.len()).map(mean).collect()
}

#[test]
fn every_episode_of_the_list_is_played_once_on_its_own_track() {
    let all = played(&policy(PolicyFamily::Beta), play(Mode::Stochastic, 21));
    assert_eq!(all.len(), 21);
    for (index, played) in all.iter().enumerate() {
        assert_eq!((played.index, played.seed), (index, 40 + index as u64));
        assert_eq!(played.steps as usize, 3 + index % WIDTH % 2);
        assert_eq!(
            (played.actions.len(), played.vectors.len()),
            (played.steps as usize, played.steps as usize)
        );
        let rewards =
            played.actions.iter().zip(&played.vectors).map(|(a, seen)| 1.0 - f64::from((a - seen).abs()));
        assert!((rewards.sum::<f64>() - played.score).abs() < 1e-5);
    }
}

#[test]
fn an_episode_does_not_depend_on_how_many_others_there_are() {
    for mode in [Mode::Deterministic, Mode::Stochastic] {
        let policy = policy(PolicyFamily::Gaussian);
        let many = played(&policy, play(mode, 19));
        assert_eq!(played(&policy, play(mode, 5)), many[..5]);
    }
}

#[test]
fn deterministic_acting_takes_the_mean_and_stochastic_acting_scatters_about_it() {
    let policy = policy(PolicyFamily::Beta);
    let fixed = played(&policy, play(Mode::Deterministic, 8));
    let means = means(&policy, &fixed[0].vectors);
    assert_eq!(fixed[0].actions, means);
    let drawn = played(&policy, play(Mode::Stochastic, 8));
    assert_ne!(drawn[0].actions, fixed[0].actions);
    let always = Play { mean_action_probability: 1.0, ..play(Mode::Stochastic, 8) };
    assert_eq!(played(&policy, always)[0].actions, fixed[0].actions);
}

#[test]
fn with_some_probability_the_whole_batch_takes_its_mean() {
    let policy = policy(PolicyFamily::Gaussian);
    let seen = Batch::Vectors { rows: 2, numbers: vec![0.1, -0.7] };
    let mean_of = means(&policy, &[0.1, -0.7]);
    let mut stream = Seed(2).stream("action");
    let (mut means, mut samples) = (0, 0);
    for _ in 0..400 {
        let acted = act(&policy, &seen, 0.1, &mut stream);
        match (acted.actions[0] == mean_of[0], acted.actions[1] == mean_of[1]) {
            (true, true) => means += 1,
            (false, false) => samples += 1,
            mixed => panic!("{mixed:?}"),
        }
    }
    assert!((15..80).contains(&means) && means + samples == 400, "{means}");
}
