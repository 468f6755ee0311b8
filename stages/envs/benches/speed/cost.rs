//! What the parts of a step cost, and a reset.

use std::hint::black_box;

use dril_envs::car_racing::CarRacing;
use dril_envs::car_racing::car::Controls;
use dril_envs::car_racing::render::{Output, Renderer};
use dril_envs::car_racing::simulation::{Rules, Simulation};
use dril_envs::lunar_lander::{LunarLander, simulation::Simulation as Flight};
use dril_envs::wrappers::preprocess::{self, FULL, SIDE};
use dril_envs::{CarRacingVersion, EnvConfig, EnvError, FrameStack, VecEnv};

use super::{WHOLE, cpu_seconds};

const RULES: Rules = Rules { lap_share: 1.0, time_limit: usize::MAX };
/// Calls between two looks at the clock.
const SLICE: usize = 100;

/// Prints the microseconds per call of `work`: the middle of many slices, and the fastest one.
pub fn measure<T>(name: &str, seconds: f64, mut work: impl FnMut() -> T) {
    let (mut slices, start) = (Vec::new(), cpu_seconds());
    loop {
        let from = cpu_seconds();
        for _ in 0..SLICE {
            black_box(work());
        }
        let now = cpu_seconds();
        slices.push((now - from) / SLICE as f64);
        if now - start > seconds {
            break;
        }
    }
    slices.sort_by(f64::total_cmp);
    let middle = slices[slices.len() / 2];
    let [middle_us, fastest_us] = [middle, slices[0]].map(|each| each * 1e6);
    println!(
        "{name:34} {middle_us:8.2} us   fastest {fastest_us:8.2} us   {:9.0} per CPU-second",
        1.0 / middle
    );
}

fn controls(step: u64) -> Controls {
    let phase = step as f64 * 0.05;
    Controls { steer: 0.3 * phase.sin(), gas: if step % 100 < 60 { 0.4 } else { 0.0 }, brake: 0.0 }
}

fn driven(seed: u64, steps: u64) -> Result<Simulation, EnvError> {
    let mut simulation = Simulation::new(CarRacing::track(seed)?.0, RULES);
    for step in 0..steps {
        simulation.step(&controls(step));
    }
    Ok(simulation)
}

/// Every part by itself.
pub fn parts(seconds: f64) -> Result<(), EnvError> {
    car(seconds)?;
    images(seconds)?;
    lander(seconds);
    resets(seconds)?;
    for threads in [1, 2, 4] {
        vectorised(threads, seconds)?;
    }
    Ok(())
}

fn car(seconds: f64) -> Result<(), EnvError> {
    let (mut simulation, mut step) = (driven(0, 0)?, 0);
    measure("car-racing: physics and tiles", seconds, || {
        step += 1;
        if (step % 500 == 0 || simulation.outcome().ended())
            && let Ok(next) = driven(step, 0)
        {
            simulation = next;
        }
        simulation.step(&controls(step))
    });
    let mut simulation = driven(1, 0)?;
    measure("  of which tyres and bodies", seconds, || {
        simulation.car_mut().control(&controls(step));
        simulation.car_mut().step(black_box([true; 4]));
    });
    Ok(())
}

fn images(seconds: f64) -> Result<(), EnvError> {
    // Several places of the road, so that no single one decides.
    let places = (0..8).map(|seed| driven(seed, 60 + 40 * seed)).collect::<Result<Vec<_>, _>>()?;
    let mut full = [0; FULL * FULL];
    for version in [CarRacingVersion::V3, CarRacingVersion::V0] {
        let mut renderer = Renderer::new(version, Output::Grey, [FULL; 2]);
        let mut place = 0;
        measure(&format!("car-racing: drawing {version:?}, 96 x 96"), seconds, || {
            place += 1;
            let simulation = &places[place % places.len()];
            renderer.draw(simulation.track(), &simulation.scene());
        });
        full.copy_from_slice(renderer.pixels());
    }
    let mut small = [0; SIDE * SIDE];
    measure("car-racing: resize to 84 x 84", seconds, || preprocess::shrink(black_box(&full), &mut small));
    let mut stack = FrameStack::new(SIDE * SIDE, 4);
    measure("car-racing: stack of 4", seconds, || stack.push(black_box(&small)));
    Ok(())
}

fn lander(seconds: f64) {
    let (mut seed, mut step) = (0, 0u32);
    let mut flight = Flight::new(&LunarLander::draws(0), usize::MAX);
    measure("lunar-lander: physics and rules", seconds, || {
        step += 1;
        let noise = f64::from(step % 17) / 17.0;
        let result = flight.step([noise, 1.0 - 2.0 * noise], [noise, -noise]);
        if result.outcome.ended() {
            seed += 1;
            flight = Flight::new(&LunarLander::draws(seed), usize::MAX);
        }
    });
}

fn resets(seconds: f64) -> Result<(), EnvError> {
    let mut seed = 0;
    for (name, text) in WHOLE {
        let Ok(config) = serde_json::from_str::<EnvConfig>(text) else { continue };
        let mut env = config.build()?;
        measure(&format!("{name}: reset"), seconds, || {
            seed += 1;
            env.reset(seed).is_ok()
        });
    }
    measure("  of which the track", seconds, || {
        seed += 1;
        CarRacing::track(seed).is_ok()
    });
    Ok(())
}

/// Steps per second of wall time, 16 environments together.
fn vectorised(threads: usize, seconds: f64) -> Result<(), EnvError> {
    const ENVS: usize = 16;
    let mut envs = VecEnv::new(&EnvConfig::default(), ENVS, threads)?;
    let mut seed = ENVS as u64;
    envs.reset_all(|env| env as u64)?;
    let (start, cpu, mut steps) = (std::time::Instant::now(), cpu_seconds(), 0u64);
    while start.elapsed().as_secs_f64() < seconds {
        let gas = controls(steps).gas as f32;
        let actions: Vec<f32> = (0..ENVS).flat_map(|_| [0.1, gas]).collect();
        envs.step(&actions, |_| {
            seed += 1;
            seed
        })?;
        steps += 1;
    }
    let (wall, cpu) = (start.elapsed().as_secs_f64(), cpu_seconds() - cpu);
    let rate = (steps * ENVS as u64) as f64 / wall;
    println!(
        "{ENVS} x car-racing, {threads} threads: {rate:.0} steps per second, {:.2} cores busy",
        cpu / wall
    );
    Ok(())
}
