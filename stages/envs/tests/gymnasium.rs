//! The bridge with the real packages, which the first run installs below the target folder (a minute or two).

#![allow(clippy::unwrap_used, clippy::panic, reason = "a test's own functions may fail the test")]

use std::path::PathBuf;
use std::process::Command;

use dril_envs::car_racing::CarRacing;
use dril_envs::car_racing::driver::drive;
use dril_envs::episode::Game;
use dril_envs::gymnasium::{self, GymnasiumConfig, PythonHome, Tracks};
use dril_envs::{
    ActionSpace, CarRacingConfig, CarRacingVersion, Env, EnvConfig, Frame, ObservationSpace, Outcome,
    OwnedFrame, Step, VecEnv,
};
use serde_json::{Value, json};

/// The Python of these tests.
fn python() -> PathBuf {
    let folder = PathBuf::from(env!("CARGO_TARGET_TMPDIR")).join("venvs");
    gymnasium::keep_python_in(PythonHome { folder, python: None });
    gymnasium::python().unwrap()
}

fn config(value: Value) -> EnvConfig {
    python();
    serde_json::from_value(json!({ "gymnasium": value })).unwrap()
}

/// Steering left and right in waves, on the gas first and on the brake at last.
fn action(t: usize) -> [f32; 2] {
    [0.2 * (t as f32 * 0.15).sin(), if t < 60 { 0.4 } else { -0.3 }]
}

fn play(env: &mut dyn Env, steps: usize, action: impl Fn(usize) -> Vec<f32>) -> Vec<(Step, OwnedFrame)> {
    let mut seen = Vec::new();
    for t in 0..steps {
        let step = env.step(&action(t)).unwrap();
        seen.push((step, env.frame().to_owned()));
        if step.outcome.ended() {
            break;
        }
    }
    seen
}

#[test]
fn the_spaces_are_those_of_the_environments() {
    for id in ["CarRacing-v3", "LunarLanderContinuous-v3", "ALE/Breakout-v5", "CartPole-v1"] {
        let config = config(json!(id));
        let env = config.build().unwrap();
        assert_eq!((env.observation_space(), env.action_space()), config.spaces().unwrap(), "{id}");
    }
    assert_eq!(config(json!("CarRacing-v3")).spaces().unwrap(), CarRacing::SPACES);
    let (shown, taken) = config(json!("ALE/Breakout-v5")).spaces().unwrap();
    assert_eq!(shown, ObservationSpace::Image { height: 84, width: 84, stack: 4 });
    assert_eq!(taken, ActionSpace::Discrete { actions: 4 });
}

#[test]
fn an_id_or_a_setting_that_gymnasium_does_not_know_is_an_error() {
    for (value, words) in [
        (json!("CarRacign-v3"), "no environment `CarRacign-v3`: Environment `CarRacign` doesn't exist"),
        (json!("LunarLanderContinuous-v2"), "Please use `LunarLanderContinuous-v3` instead"),
        (json!({ "id": "CarRacing-v3", "kwargs": { "laps": 3 } }), "unexpected keyword argument 'laps'"),
        (json!({ "id": "ALE/Breakout-v5", "kwargs": { "clip": true } }), "no setting clip; its settings are"),
    ] {
        let error = config(value).build().err().unwrap().to_string();
        assert!(error.contains(words), "{error}");
    }
}

/// The way points (angle, heading, x, y) that Gymnasium makes of our draws, by the worker's own code.
fn their_tracks(seeds: &[u64]) -> Vec<Vec<[f64; 4]>> {
    const SCRIPT: &str = r#"
import json, sys
worker, draws = sys.argv[1], json.loads(sys.argv[2])
exec(worker[:worker.rindex("\ntry:\n    main()")])
import gymnasium
order = {"id": "CarRacing-v3", "kwargs": {}, "time_limit": None, "images": False}
tracks, env = [], Plain(gymnasium, order)
for numbers in draws:
    env.reset(None, numbers)
    tracks.append(env.env.unwrapped.track)
print(json.dumps(tracks))
"#;
    let draws: Vec<Vec<f64>> =
        seeds.iter().map(|seed| CarRacing::track_draws(*seed).unwrap().to_vec()).collect();
    let worker = include_str!("../src/gymnasium/worker.py");
    let output = Command::new(python())
        .args(["-c", SCRIPT, worker, &serde_json::to_string(&draws).unwrap()])
        .env("PYGAME_HIDE_SUPPORT_PROMPT", "1")
        .output()
        .unwrap();
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    serde_json::from_slice(&output.stdout).unwrap()
}

#[test]
fn draws_that_are_handed_over_make_the_same_track() {
    let seeds: Vec<u64> = (0..40).collect();
    let retried = seeds.iter().filter(|seed| CarRacing::track(**seed).unwrap().1 > 1).count();
    assert!(retried > 0, "some seed must need a second attempt");
    for (seed, theirs) in seeds.iter().zip(their_tracks(&seeds)) {
        let ours = CarRacing::track(*seed).unwrap().0.way_points;
        assert_eq!(ours.len(), theirs.len(), "seed {seed}");
        for (ours, theirs) in ours.iter().zip(theirs) {
            let ours = [ours.alpha, ours.beta, ours.x, ours.y];
            let off = ours.iter().zip(theirs).map(|(a, b)| (a - b).abs()).fold(0.0, f64::max);
            assert!(off < 1e-6, "seed {seed}: {ours:?} {theirs:?}");
        }
    }
}

#[test]
fn on_the_same_track_the_same_actions_come_to_the_same() {
    let theirs = config(json!({ "id": "CarRacing-v3", "tracks": "car-racing" }));
    let ours = CarRacingConfig { version: CarRacingVersion::V3, ..CarRacingConfig::default() };
    let (mut ours, mut theirs) = (EnvConfig::CarRacing(ours).build().unwrap(), theirs.build().unwrap());
    for seed in [3, 2_000_000] {
        let [ours, theirs] = [&mut ours, &mut theirs].map(|env| {
            env.reset(seed).unwrap();
            play(env.as_mut(), 80, |t| action(t).to_vec())
        });
        let score = |seen: &[(Step, OwnedFrame)]| seen.iter().map(|(step, _)| step.reward).sum::<f64>();
        // A tile is worth 3 to 5 points; one may be reached a step earlier or later.
        assert!((score(&ours) - score(&theirs)).abs() < 6.0, "{} {}", score(&ours), score(&theirs));
        for ((_, ours), (_, theirs)) in ours.iter().zip(&theirs) {
            let (Frame::Image(a), Frame::Image(b)) = (ours.as_frame(), theirs.as_frame()) else { panic!() };
            let far = a.iter().zip(b).filter(|(a, b)| a.abs_diff(**b) > 8).count();
            assert!(far < a.len() / 20, "{far} of {} pixels differ", a.len());
        }
    }
}

#[test]
fn a_lap_of_ours_is_a_lap_in_gymnasium_when_its_actions_are_repeated_blindly() {
    let rules = CarRacingConfig { version: CarRacingVersion::V3, ..CarRacingConfig::default() };
    let mut ours = CarRacing::new(rules);
    let seed = 4_000_002;
    ours.reset(seed).unwrap();
    let (mut actions, mut score, mut outcome) = (Vec::new(), 0.0, Outcome::Running);
    while !outcome.ended() {
        let controls = ours.simulation().map(drive).unwrap();
        actions.push([controls.steer as f32, (controls.gas - controls.brake) as f32]);
        let step = ours.step(actions.last().unwrap()).unwrap();
        (score, outcome) = (score + step.reward, step.outcome);
    }
    assert_eq!(outcome, Outcome::Finished);
    let mut theirs = config(json!({ "id": "CarRacing-v3", "tracks": "car-racing" })).build().unwrap();
    theirs.reset(seed).unwrap();
    let seen = play(theirs.as_mut(), actions.len() + 5, |t| actions[t.min(actions.len() - 1)].to_vec());
    let (steps, their_outcome) = (seen.len(), seen.last().unwrap().0.outcome);
    let their_score: f64 = seen.iter().map(|(step, _)| step.reward).sum();
    let both = format!("{} steps, {score}; {steps} steps, {their_score}", actions.len());
    assert_eq!(their_outcome, Outcome::Finished, "{both}");
    // A centimetre at the finish may be a step.
    assert!(steps.abs_diff(actions.len()) <= 1 && (score - their_score).abs() < 0.2, "{both}");
}

#[test]
fn an_episode_follows_from_its_seed_and_actions_alone() {
    for (id, values, steps) in
        [("CarRacing-v3", 2, 12), ("LunarLanderContinuous-v3", 2, 60), ("ALE/Breakout-v5", 1, 30)]
    {
        let config = config(json!(id));
        let act = |t: usize| {
            let value = if values == 1 { (t * 7 % 4) as f32 } else { (t as f32 * 0.3).sin() };
            vec![value; values]
        };
        let mut env = config.build().unwrap();
        env.reset(5).unwrap();
        let first = play(env.as_mut(), steps, act);
        env.reset(6).unwrap();
        assert_ne!(play(env.as_mut(), steps, act), first, "{id}: another seed is another episode");
        env.reset(5).unwrap();
        assert_eq!(play(env.as_mut(), steps, act), first, "{id}");
        let mut other = config.build().unwrap();
        other.restore(&env.snapshot()).unwrap();
        assert_eq!(env.frame(), other.frame(), "{id}");
        let last = first.len();
        assert_eq!(env.step(&act(last)).unwrap(), other.step(&act(last)).unwrap(), "{id}");
    }
}

#[test]
fn time_limits_and_ends_are_told_apart() {
    let limited = config(json!({ "id": "ALE/Breakout-v5", "time_limit": 4 }));
    let mut envs = VecEnv::new(&limited, 2, 1).unwrap();
    envs.reset_all(|env| env as u64).unwrap();
    for t in 1..=4 {
        let steps = envs.step(&[0.0, 1.0], |env| 10 + env as u64).unwrap();
        let wanted = if t == 4 { Outcome::TimeLimit } else { Outcome::Running };
        assert!(steps.iter().all(|step| step.outcome == wanted), "step {t}");
    }
    let mut crash = config(json!("LunarLanderContinuous-v3")).build().unwrap();
    crash.reset(1).unwrap();
    let fall = play(crash.as_mut(), 1000, |_| vec![-1.0, 0.0]);
    assert_eq!(fall.last().unwrap().0.outcome, Outcome::Failed);
    assert_eq!(fall.last().unwrap().0.reward, -100.0);
}

#[test]
fn an_episode_can_be_rendered() {
    let mut envs = [GymnasiumConfig::new("CarRacing-v3"), GymnasiumConfig::new("ALE/Breakout-v5")];
    envs[0].tracks = Tracks::CarRacing;
    python();
    for config in envs {
        let mut env = EnvConfig::Gymnasium(config).build().unwrap();
        env.reset(1).unwrap();
        let values = env.action_space().action_len();
        for _ in 0..3 {
            env.step(&vec![0.0; values]).unwrap();
        }
        let before = env.frame().to_owned();
        let image = env.render(300, 200).unwrap();
        assert_eq!(image.rgb.len(), 300 * 200 * 3);
        let colours: std::collections::BTreeSet<&[u8]> = image.rgb.chunks(3).collect();
        assert!(colours.len() > 4);
        assert_eq!(env.frame().to_owned(), before, "looking changes nothing");
    }
}
