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
use dril_envs::{CarRacingConfig, CarRacingVersion, EnvConfig, Frame, FrameStack};

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

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let seconds = std::env::args().nth(1).and_then(|s| s.parse().ok()).unwrap_or(2.0);
    let track = |seed| CarRacing::track(seed).map(|(track, _)| track);
    let (mut seed, mut step) = (0, 0);
    let mut simulation = Simulation::new(track(0)?, RULES);
    measure("physics and tiles", seconds, || {
        step += 1;
        if step % 500 == 0 || simulation.outcome().ended() {
            seed += 1;
            if let Ok(track) = track(seed) {
                simulation = Simulation::new(track, RULES);
            }
        }
        black_box(simulation.step(&controls(step)));
    });
    let mut simulation = Simulation::new(track(1)?, RULES);
    for step in 0..120 {
        simulation.step(&controls(step));
    }
    let mut renderer = Renderer::new(CarRacingVersion::V3, Output::Grey, [FULL; 2]);
    measure("drawing V3, 96 x 96 grey", seconds, || {
        renderer.draw(black_box(simulation.track()), &simulation.scene());
    });
    let mut renderer = Renderer::new(CarRacingVersion::V0, Output::Grey, [FULL; 2]);
    measure("drawing V0, 96 x 96 grey", seconds, || {
        renderer.draw(black_box(simulation.track()), &simulation.scene());
    });
    let full: [u8; FULL * FULL] = renderer.pixels().try_into()?;
    let mut small = [0; SIDE * SIDE];
    measure("resize to 84 x 84", seconds, || preprocess::shrink(black_box(&full), &mut small));
    let mut stack = FrameStack::new(SIDE * SIDE, 4);
    measure("stack of 4", seconds, || stack.push(black_box(&small)));
    for version in [CarRacingVersion::V0, CarRacingVersion::V3] {
        let mut env = EnvConfig::CarRacing(CarRacingConfig { version, ..Default::default() }).build()?;
        env.reset(0)?;
        let (mut seed, mut step) = (0, 0u64);
        measure(&format!("whole env {version:?}, 84 x 84 x 4"), seconds, || {
            step += 1;
            let action = [(0.3 * (step as f64 * 0.05).sin()) as f32, if step % 100 < 60 { 0.4 } else { 0.0 }];
            let ended = env.step(&action).is_ok_and(|step| step.outcome.ended());
            if let Frame::Image(pixels) = env.frame() {
                stack.push(pixels);
            }
            if ended {
                seed += 1;
                black_box(env.reset(seed).is_ok());
            }
        });
        measure(&format!("reset {version:?}"), seconds, || {
            seed += 1;
            black_box(env.reset(seed).is_ok());
        });
    }
    measure("track only", seconds, || {
        seed += 1;
        black_box(CarRacing::track(seed).is_ok());
    });
    Ok(())
}
