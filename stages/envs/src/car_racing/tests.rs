//! The game's rules: rewards, ends of episodes and own tracks.

use super::*;
use crate::car_racing::driver::drive;
use crate::conformance::conformance_tests;
use crate::{CarRacingVersion, Outcome};
use track::PLAYFIELD;

const ALL_TILES: Rules = Rules { lap_share: 1.0, time_limit: 1000 };

fn simulation(seed: u64, rules: Rules) -> Simulation {
    Simulation::new(CarRacing::track(seed).unwrap().0, rules)
}

fn env(time_limit: u32) -> CarRacing {
    CarRacing::new(CarRacingConfig { time_limit, ..CarRacingConfig::default() })
}

conformance_tests!(env);

#[test]
fn the_reset_visits_two_tiles_which_the_first_step_pays() {
    for seed in 0..40 {
        let mut simulation = simulation(seed, ALL_TILES);
        assert_eq!(simulation.tiles().visits(), 2, "seed {seed}");
        let step = simulation.step(&Controls::default());
        let wanted = 1000.0 / simulation.tiles().len() as f64 * simulation.tiles().visits() as f64 - 0.1;
        assert!((step.reward - wanted).abs() < 1e-9, "seed {seed}: {} {wanted}", step.reward);
    }
}

#[test]
fn a_tile_is_paid_one_step_after_the_wheel_reached_it() {
    let mut simulation = simulation(3, ALL_TILES);
    let gas = Controls { gas: 1.0, ..Controls::default() };
    let mut checked = 0;
    for _ in 0..60 {
        // What the tile rules see of the car as it stands now is what the next step pays.
        let mut tiles = simulation.tiles().clone();
        let world = simulation.car().world();
        let new = tiles.touch(world.hull(), world.wheels()).new_visits;
        let first = simulation.steps() == 0;
        let reward = simulation.step(&gas).reward;
        let wanted = 1000.0 / simulation.tiles().len() as f64 * new as f64 - 0.1;
        if !first {
            assert!((reward - wanted).abs() < 1e-9, "{reward} {wanted}");
            checked += new;
        }
    }
    assert!(checked > 3, "only {checked} tiles were reached");
}

#[test]
fn leaving_the_playfield_pays_minus_100_instead_of_the_step() {
    let mut simulation = simulation(0, Rules { time_limit: 5000, ..ALL_TILES });
    let mut last = None;
    while simulation.outcome() == Outcome::Running {
        last = Some(simulation.step(&Controls { gas: 0.3, ..Controls::default() }));
    }
    assert_eq!(last.unwrap(), Step { reward: -100.0, outcome: Outcome::Failed });
    let [x, y] = simulation.car().hull().position;
    assert!(x.abs().max(y.abs()) > PLAYFIELD);
}

#[test]
fn a_lap_needs_all_tiles_or_the_given_share_and_the_start_line() {
    let lap = |lap_share| {
        let mut simulation = simulation(5, Rules { lap_share, time_limit: 3000 });
        let mut score = 0.0;
        while simulation.outcome() == Outcome::Running {
            score += simulation.step(&drive(&simulation)).reward;
        }
        assert_eq!(simulation.outcome(), Outcome::Finished);
        let (n, visits) = (simulation.tiles().len(), simulation.tiles().visits());
        let wanted = 1000.0 * visits as f64 / n as f64 - 0.1 * simulation.steps() as f64;
        assert!((score - wanted).abs() < 1e-6, "{score} {wanted}");
        (n, visits, simulation.steps())
    };
    let (n, all, steps) = lap(1.0);
    assert_eq!(all, n);
    let (_, visits, earlier) = lap(0.5);
    assert!(visits as f64 > 0.5 * n as f64 && earlier <= steps, "{visits} of {n} after {earlier}");
}

#[test]
fn an_episode_restored_while_a_stop_holds_the_steering_continues_bit_identically() {
    let held = |env: &CarRacing| env.simulation().unwrap().car().world().stops()[0].hold();
    let mut one = env(1000);
    one.reset(11).unwrap();
    for _ in 0..20 {
        one.step(&[1.0, 0.3]).unwrap();
    }
    assert!(held(&one) > 1.0, "{}", held(&one));
    let mut other = env(1000);
    other.restore(&one.snapshot()).unwrap();
    assert_eq!(held(&one), held(&other));
    // Called back slowly: the stop holds on for some steps, then lets go.
    let steering = -one.simulation().unwrap().car().world().joint_angle(0) as f32 - 0.004;
    let mut holding = Vec::new();
    for _ in 0..40 {
        assert_eq!(one.step(&[steering, 0.3]), other.step(&[steering, 0.3]));
        assert_eq!(one.frame(), other.frame());
        let [poses, again] = [&one, &other].map(|env| *env.simulation().unwrap().car().world().poses());
        assert_eq!(poses, again);
        holding.push(held(&one) > 0.0);
    }
    assert!(holding[2] && !holding[39], "{holding:?}");
}

#[test]
fn both_versions_show_grass_road_and_car_at_their_places() {
    for version in [CarRacingVersion::V0, CarRacingVersion::V3] {
        let mut env = CarRacing::new(CarRacingConfig { version, ..CarRacingConfig::default() });
        env.reset(4).unwrap();
        for _ in 0..60 {
            env.step(&[0.0, 0.05]).unwrap();
        }
        let Frame::Image(pixels) = env.frame() else { unreachable!() };
        let around = |row: usize, column: usize| pixels[row * SIDE + column];
        assert!((95..=110).contains(&around(20, 42)), "{version:?}: road ahead is {}", around(20, 42));
        assert!((150..=180).contains(&around(40, 3)), "{version:?}: grass is {}", around(40, 3));
        assert!(around(63, 42) < 75, "{version:?}: the car is {}", around(63, 42));
        assert_eq!(around(75, 80), 0, "{version:?}: the bar");
    }
}

#[test]
fn the_car_starts_between_the_lines_of_its_map_and_its_pose_moves_as_fast_as_it_says() {
    let mut env = env(1000);
    assert!(env.pose().is_none() && env.map().is_empty(), "there is no episode yet");
    env.reset(4).unwrap();
    let (start, map) = (env.pose().unwrap(), env.map());
    assert_eq!(map.iter().map(|line| line.name).collect::<Vec<_>>(), ["left", "right"]);
    for line in &map {
        assert_eq!(line.points.first(), line.points.last(), "a closed line");
        let distance = |[x, y]: &[f64; 2]| (x - start.x).hypot(y - start.y);
        let nearest = line.points.iter().map(distance).reduce(f64::min).unwrap();
        assert!(nearest < 3.0 * track::HALF_WIDTH, "{nearest}");
    }
    for _ in 0..50 {
        env.step(&[0.0, 1.0]).unwrap();
    }
    let before = env.pose().unwrap();
    env.step(&[0.0, 1.0]).unwrap();
    let after = env.pose().unwrap();
    let way = (after.x - before.x).hypot(after.y - before.y);
    assert!((way * 50.0 / after.speed - 1.0).abs() < 0.05, "{way} {}", after.speed);
}
