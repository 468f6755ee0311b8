//! The contract of an environment, held by one that another process plays.

use super::worker::tests::fake;
use super::*;
use crate::VecEnv;

fn env(id: &str) -> GymnasiumEnv {
    start(&fake(), &GymnasiumConfig::new(id), 1, 1).unwrap().remove(0)
}

fn several(count: usize, workers: usize) -> VecEnv {
    let envs = start(&fake(), &GymnasiumConfig::new("counter"), count, workers).unwrap();
    let spaces = envs[0].spaces;
    VecEnv::of(envs.into_iter().map(|env| Box::new(env) as Box<dyn Env>).collect(), spaces, workers).unwrap()
}

#[test]
fn faults_are_refused_before_they_reach_the_worker() {
    let mut env = env("counter");
    assert_eq!(env.step(&[0.0]), Err(EnvError::NotStarted));
    env.reset(3).unwrap();
    assert_eq!(env.step(&[0.0, 0.0]), Err(EnvError::ActionLength { seen: 2, expected: 1 }));
    assert_eq!(env.step(&[f32::NAN]), Err(EnvError::ActionNan { dimension: 0 }));
    for _ in 0..5 {
        env.step(&[9.0]).unwrap();
    }
    assert_eq!(env.step(&[0.0]), Err(EnvError::Over { length: 5 }));
    assert_eq!(env.snapshot().actions, [1.0; 5], "actions are clamped");
}

#[test]
fn choices_are_whole_numbers_that_there_are() {
    let mut env = env("choices");
    assert_eq!(env.action_space(), ActionSpace::Discrete { actions: 3 });
    env.reset(3).unwrap();
    env.step(&[2.0]).unwrap();
    for chosen in [3.0, -1.0, 0.5] {
        assert_eq!(env.step(&[chosen]), Err(EnvError::Choice { chosen, choices: 3 }));
    }
}

#[test]
fn images_of_any_size_become_the_thesis_s_view() {
    let mut env = env("image");
    env.reset(3).unwrap();
    env.step(&[0.0]).unwrap();
    env.step(&[0.0]).unwrap();
    assert_eq!(env.frame(), Frame::Image(&[2; SIDE * SIDE]));
}

#[test]
fn a_restored_environment_goes_on_as_the_one_that_was_saved() {
    let mut one = env("counter");
    one.reset(31).unwrap();
    for action in [0.25, -0.5] {
        one.step(&[action]).unwrap();
    }
    let mut other = env("counter");
    other.restore(&one.snapshot()).unwrap();
    assert_eq!(one.frame(), other.frame());
    assert_eq!(one.step(&[0.75]), other.step(&[0.75]));
    let too_long = EnvSnapshot { seed: Some(30), actions: vec![0.0; 6] };
    assert!(matches!(other.restore(&too_long), Err(EnvError::Snapshot(_))));
}

#[test]
fn the_number_of_processes_changes_nothing() {
    let play = |workers| {
        let (mut envs, mut seed) = (several(5, workers), 100);
        let mut next = |_| {
            seed += 1;
            seed
        };
        envs.reset_all(&mut next).unwrap();
        let mut seen = Vec::new();
        for t in 0..20 {
            let actions: Vec<f32> = (0..5).map(|env| ((t * 5 + env) as f32 * 0.1).sin()).collect();
            seen.extend(envs.step(&actions, &mut next).unwrap().to_vec());
        }
        let frames: Vec<_> = (0..5).map(|env| envs.frame(env).to_owned()).collect();
        (seen, frames, envs.snapshot())
    };
    let one = play(1);
    assert!(one.0.iter().filter(|step| step.finished.is_some()).count() > 5);
    assert_eq!(one, play(2));
    assert_eq!(one, play(5));
}

#[test]
fn a_step_that_was_begun_and_given_up_disturbs_nothing() {
    let mut env = env("counter");
    env.reset(7).unwrap();
    env.begin(&[1.0]).unwrap();
    env.reset(9).unwrap();
    assert_eq!(env.step(&[1.0]).unwrap().reward, 10.0);
}

#[test]
fn looking_changes_nothing_and_scales_the_image() {
    let (mut watched, mut unseen) = (env("counter"), env("counter"));
    for env in [&mut watched, &mut unseen] {
        env.reset(31).unwrap();
        env.step(&[0.5]).unwrap();
    }
    let image = watched.render(4, 6).unwrap();
    assert_eq!((image.width, image.height), (4, 6));
    assert_eq!(image.rgb, [200, 100, 1].repeat(24));
    assert_eq!(watched.step(&[0.5]), unseen.step(&[0.5]));
    assert!(matches!(watched.render(0, 6), Err(EnvError::Render(_))));
}
