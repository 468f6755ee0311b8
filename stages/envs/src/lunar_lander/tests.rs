//! The game's rules: rewards and ends of episodes.

use super::*;
use crate::Outcome;
use crate::conformance::conformance_tests;
use crate::lunar_lander::pilot::fly;

fn env(time_limit: u32) -> LunarLander {
    LunarLander::new(LunarLanderConfig { time_limit })
}

conformance_tests!(env);

/// Flies by what the pilot sees until the end: the last step, and the sum of the rewards.
fn flown(env: &mut LunarLander, mut pilot: impl FnMut(&[f64; OBSERVED]) -> [f64; 2]) -> (Step, f64) {
    let mut total = 0.0;
    loop {
        let action = pilot(env.simulation().unwrap().observation());
        let step = env.step(&action.map(|v| v as f32)).unwrap();
        total += step.reward;
        if step.outcome.ended() {
            return (step, total);
        }
    }
}

#[test]
fn a_landing_pays_100_and_is_no_failure() {
    let mut env = env(1000);
    env.reset(3).unwrap();
    let (last, total) = flown(&mut env, fly);
    assert_eq!(last, Step { reward: 100.0, outcome: Outcome::Finished });
    assert!((200.0..330.0).contains(&total), "{total}");
    let observation = env.simulation().unwrap().observation();
    assert_eq!(observation[6..], [1.0, 1.0]);
    assert!(observation[1].abs() < 0.02, "{observation:?}");
}

#[test]
fn a_crash_and_leaving_the_world_pay_minus_100() {
    let mut crashes = 0;
    for seed in 0..8 {
        let mut env = env(1000);
        env.reset(seed).unwrap();
        let (last, _) = flown(&mut env, |_| [0.0; 2]);
        assert_eq!(last, Step { reward: -100.0, outcome: Outcome::Failed });
        crashes += usize::from(env.simulation().unwrap().observation()[0].abs() < 1.0);
        // Steady thrust to one side leaves the world.
        env.reset(seed).unwrap();
        let (last, _) = flown(&mut env, |seen| [1.0, if seen[4] > -0.5 { 1.0 } else { -0.6 }]);
        assert_eq!((last.reward, last.outcome), (-100.0, Outcome::Failed));
    }
    assert!(crashes > 4, "{crashes} of 8 fell on the ground");
}

#[test]
fn rewards_are_changes_of_the_potential_less_fuel() {
    let mut env = env(1000);
    env.reset(1).unwrap();
    let potential = |env: &LunarLander| {
        let [x, y, vx, vy, angle, _, right, left] = *env.simulation().unwrap().observation();
        10.0 * (right + left) - 100.0 * (x.hypot(y) + vx.hypot(vy) + angle.abs())
    };
    for (action, fuel) in [([0.0, 0.0], 0.0), ([1.0, 0.0], 0.3), ([0.5, -1.0], 0.225 + 0.03)] {
        let before = potential(&env);
        let reward = env.step(&action).unwrap().reward;
        assert!((reward - (potential(&env) - before - fuel)).abs() < 1e-9, "{action:?}: {reward}");
    }
}

#[test]
fn the_noise_of_the_engines_is_drawn_whether_they_run_or_not() {
    let after = |first: [f32; 2]| {
        let mut env = env(100);
        env.reset(2).unwrap();
        env.step(&first).unwrap();
        env.episode.as_mut().unwrap().simulation.dispersion.next_u64()
    };
    assert_eq!(after([0.0, 0.0]), after([1.0, 1.0]));
}

#[test]
fn the_image_shows_sky_ground_flags_lander_and_flame() {
    let mut env = env(1000);
    env.reset(3).unwrap();
    // Fly down into the image, then fire.
    for _ in 0..70 {
        let action = fly(env.simulation().unwrap().observation());
        env.step(&action.map(|v| v as f32)).unwrap();
    }
    env.step(&[1.0, 0.0]).unwrap();
    let image = env.render(300, 200).unwrap();
    assert_eq!((image.width, image.height, image.rgb.len()), (300, 200, 300 * 200 * 3));
    let has = |colour: [u8; 3]| image.rgb.chunks_exact(3).filter(|pixel| **pixel == colour).count();
    // Sky, ground, flag, lander and flame, as the palette has them.
    for (colour, least) in [
        ([13, 15, 34], 10_000),
        ([104, 102, 112], 5_000),
        ([226, 178, 32], 10),
        ([136, 112, 232], 50),
        ([255, 132, 28], 10),
    ] {
        assert!(has(colour) >= least, "{colour:?}: {} pixels", has(colour));
    }
}

#[test]
fn the_lander_falls_towards_the_ground_of_its_map() {
    let mut env = env(1000);
    assert!(env.pose().is_none() && env.map().is_empty(), "there is no episode yet");
    env.reset(4).unwrap();
    let map = env.map();
    assert_eq!((map.len(), map[0].name, map[0].points.len()), (1, "ground", terrain::POINTS));
    let highest = map[0].points.iter().map(|[_, y]| *y).reduce(f64::max).unwrap();
    let start = env.pose().unwrap();
    for _ in 0..20 {
        env.step(&[-1.0, 0.0]).unwrap();
    }
    let later = env.pose().unwrap();
    assert!(start.y > later.y && later.y > highest, "{start:?} {later:?} {highest}");
    assert!(later.speed > 0.0);
}
