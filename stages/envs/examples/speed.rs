//! Where a step's microseconds go: `cargo run --release -p dril-envs --example speed [-- SECONDS]`.
//!
//! One thread; steps per CPU-second (user + system time of this process), so that a busy machine disturbs it less.
#![allow(clippy::print_stdout)]

use std::alloc::{GlobalAlloc, Layout, System};
use std::hint::black_box;
use std::sync::atomic::{AtomicUsize, Ordering};

use dril_envs::car_racing::CarRacing;
use dril_envs::car_racing::car::Controls;
use dril_envs::car_racing::render::{Output, Renderer};
use dril_envs::car_racing::simulation::{Rules, Simulation};
use dril_envs::preprocess::{self, FULL, SIDE};
use dril_envs::{CarRacingConfig, CarRacingVersion, EnvConfig, EnvError, Frame, FrameStack, VecEnv};

/// Counts allocations, so that the table can say how many a step takes.
struct Counting;

static ALLOCATIONS: AtomicUsize = AtomicUsize::new(0);

// SAFETY: every call is handed to the system's allocator unchanged.
#[allow(unsafe_code)]
unsafe impl GlobalAlloc for Counting {
    unsafe fn alloc(&self, layout: Layout) -> *mut u8 {
        ALLOCATIONS.fetch_add(1, Ordering::Relaxed);
        // SAFETY: the caller keeps `alloc`'s contract.
        unsafe { System.alloc(layout) }
    }

    unsafe fn dealloc(&self, pointer: *mut u8, layout: Layout) {
        // SAFETY: the caller keeps `dealloc`'s contract.
        unsafe { System.dealloc(pointer, layout) }
    }
}

#[global_allocator]
static GLOBAL: Counting = Counting;

const RULES: Rules = Rules { lap_share: 1.0, time_limit: usize::MAX };

/// CPU seconds that this process has used.
fn cpu_seconds() -> f64 {
    let time = rustix::time::clock_gettime(rustix::time::ClockId::ProcessCPUTime);
    time.tv_sec as f64 + time.tv_nsec as f64 / 1e9
}

/// Microseconds and allocations per call of `work`, over about `seconds` of CPU time.
fn measure(name: &str, seconds: f64, mut work: impl FnMut()) -> f64 {
    for _ in 0..20 {
        work();
    }
    let (mut calls, start, allocations) = (0u64, cpu_seconds(), ALLOCATIONS.load(Ordering::Relaxed));
    let mut best = f64::INFINITY;
    let mut spent = 0.0;
    while spent < seconds {
        let slice = cpu_seconds();
        for _ in 0..200 {
            work();
        }
        calls += 200;
        let now = cpu_seconds();
        best = best.min((now - slice) / 200.0);
        spent = now - start;
    }
    let each = spent / calls as f64;
    let allocated = ALLOCATIONS.load(Ordering::Relaxed) - allocations;
    let own = allocated as f64 / calls as f64;
    println!(
        "{name:32} {:9.2} us   best slice {:9.2} us   {:10.0} /CPU-s   {own:8.3} allocations",
        each * 1e6,
        best * 1e6,
        1.0 / each
    );
    each
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

fn physics(seconds: f64) -> Result<(), EnvError> {
    let (mut seed, mut step) = (0, 0);
    let mut simulation = driven(0, 0)?;
    measure("physics and tiles", seconds, || {
        step += 1;
        if step % 500 == 0 || simulation.outcome().ended() {
            seed += 1;
            if let Ok(next) = driven(seed, 0) {
                simulation = next;
            }
        }
        black_box(simulation.step(&controls(step)));
    });
    let mut simulation = driven(1, 0)?;
    measure("  of which tyres and bodies", seconds, || {
        simulation.car_mut().control(&controls(step));
        simulation.car_mut().step(black_box([true; 4]));
    });
    Ok(())
}

fn pictures(seconds: f64) -> Result<(), EnvError> {
    let simulation = driven(1, 120)?;
    let mut full = [0; FULL * FULL];
    for version in [CarRacingVersion::V3, CarRacingVersion::V0] {
        let mut renderer = Renderer::new(version, Output::Grey, [FULL; 2]);
        measure(&format!("drawing {version:?}, 96 x 96 grey"), seconds, || {
            renderer.draw(black_box(simulation.track()), &simulation.scene());
        });
        full.copy_from_slice(renderer.pixels());
    }
    let mut small = [0; SIDE * SIDE];
    measure("resize to 84 x 84", seconds, || preprocess::shrink(black_box(&full), &mut small));
    let mut stack = FrameStack::new(SIDE * SIDE, 4);
    measure("stack of 4", seconds, || stack.push(black_box(&small)));
    Ok(())
}

fn whole(version: CarRacingVersion, seconds: f64) -> Result<(), EnvError> {
    let mut env = EnvConfig::CarRacing(CarRacingConfig { version, ..Default::default() }).build()?;
    env.reset(0)?;
    let mut stack = FrameStack::new(SIDE * SIDE, 4);
    let (mut seed, mut step) = (0, 0u64);
    measure(&format!("whole env {version:?}, 84 x 84 x 4"), seconds, || {
        step += 1;
        let controls = controls(step);
        let ended = env.step(&[controls.steer as f32, controls.gas as f32]);
        if let Frame::Image(pixels) = env.frame() {
            stack.push(pixels);
        }
        if ended.is_ok_and(|step| step.outcome.ended()) {
            seed += 1;
            black_box(env.reset(seed).is_ok());
        }
    });
    measure(&format!("reset {version:?}"), seconds, || {
        seed += 1;
        black_box(env.reset(seed).is_ok());
    });
    Ok(())
}

/// Steps per second of wall time, 16 environments together.
fn vectorised(threads: usize, seconds: f64) -> Result<(), EnvError> {
    const ENVS: usize = 16;
    let mut envs = VecEnv::new(&EnvConfig::default(), ENVS, threads)?;
    let mut seed = ENVS as u64;
    envs.reset_all(|env| env as u64)?;
    let (start, mut steps) = (std::time::Instant::now(), 0u64);
    while start.elapsed().as_secs_f64() < seconds {
        let actions: Vec<f32> = (0..ENVS).flat_map(|_| [0.1, controls(steps).gas as f32]).collect();
        envs.step(&actions, |_| {
            seed += 1;
            seed
        })?;
        steps += 1;
    }
    let rate = (steps * ENVS as u64) as f64 / start.elapsed().as_secs_f64();
    println!("{ENVS} envs on {threads} threads: {rate:.0} steps per second of wall time");
    Ok(())
}

fn main() -> Result<(), EnvError> {
    let seconds = std::env::args().nth(1).and_then(|s| s.parse().ok()).unwrap_or(2.0);
    physics(seconds)?;
    pictures(seconds)?;
    whole(CarRacingVersion::V0, seconds)?;
    whole(CarRacingVersion::V3, seconds)?;
    let mut seed = 0;
    measure("track only", seconds, || {
        seed += 1;
        black_box(CarRacing::track(seed).is_ok());
    });
    [1, 2].into_iter().try_for_each(|threads| vectorised(threads, seconds))
}
