//! A step takes no memory: what is allocated at all belongs to the physics engine, and is counted here.
#![allow(clippy::unwrap_used)]

use std::alloc::{GlobalAlloc, Layout, System};
use std::cell::Cell;

use dril_envs::car_racing::CarRacing;
use dril_envs::car_racing::car::Controls;
use dril_envs::car_racing::simulation::{Rules, Simulation};
use dril_envs::lunar_lander::engines::Push;
use dril_envs::lunar_lander::start::Start;
use dril_envs::lunar_lander::terrain::Terrain;
use dril_envs::lunar_lander::world::LanderWorld;
use dril_envs::lunar_lander::{LunarLander, simulation::Simulation as Flight};
use dril_envs::{EnvConfig, Frame, FrameStack};

/// Counts allocations of this thread.
struct Counting;

thread_local! {
    static COUNT: Cell<usize> = const { Cell::new(0) };
}

// SAFETY: every call is handed to the system's allocator unchanged.
#[allow(unsafe_code)]
unsafe impl GlobalAlloc for Counting {
    unsafe fn alloc(&self, layout: Layout) -> *mut u8 {
        let _ = COUNT.try_with(|count| count.set(count.get() + 1));
        // SAFETY: the caller keeps `alloc`'s contract.
        unsafe { System.alloc(layout) }
    }

    unsafe fn dealloc(&self, pointer: *mut u8, layout: Layout) {
        // SAFETY: the caller keeps `dealloc`'s contract.
        unsafe { System.dealloc(pointer, layout) }
    }

    unsafe fn realloc(&self, pointer: *mut u8, layout: Layout, size: usize) -> *mut u8 {
        let _ = COUNT.try_with(|count| count.set(count.get() + 1));
        // SAFETY: the caller keeps `realloc`'s contract.
        unsafe { System.realloc(pointer, layout, size) }
    }
}

#[global_allocator]
static GLOBAL: Counting = Counting;

/// Allocations of `steps` calls, after as many to warm up.
fn allocations(steps: usize, mut step: impl FnMut(usize)) -> usize {
    (0..steps).for_each(&mut step);
    let before = COUNT.with(Cell::get);
    (0..steps).for_each(&mut step);
    COUNT.with(Cell::get) - before
}

fn action(step: usize) -> [f32; 2] {
    let at = step as f32 * 0.05;
    [0.4 * at.sin(), if step % 100 < 60 { 0.4 } else { -0.1 }]
}

#[test]
fn the_counter_counts() {
    assert_eq!(allocations(10, |_| drop(std::hint::black_box(vec![1u8]))), 10);
}

#[test]
fn a_step_of_car_racing_with_image_and_stack_allocates_only_inside_the_physics_engine() {
    for version in ["v0", "v3"] {
        let config: EnvConfig =
            serde_json::from_str(&format!(r#"{{"car-racing": {{"version": "{version}"}}}}"#)).unwrap();
        let mut env = config.build().unwrap();
        env.reset(1).unwrap();
        let mut stack = FrameStack::new(84 * 84, 4);
        let whole = allocations(200, |step| {
            env.step(&action(step)).unwrap();
            if let Frame::Image(pixels) = env.frame() {
                stack.push(pixels);
            }
        });
        let rules = Rules { lap_share: 1.0, time_limit: usize::MAX };
        let mut simulation = Simulation::new(CarRacing::track(1).unwrap().0, rules);
        let engine = allocations(200, |_| {
            simulation.car_mut().control(&Controls { gas: 0.3, ..Controls::default() });
            simulation.car_mut().step([true; 4]);
        });
        assert_eq!(whole, engine, "{version}: rules, image or stack allocate");
        // Four in a release build, all in rapier2d 0.36.1: the list of moved bodies (twice, as it grows), which it takes and
        // starts again (`step_inner` in pipeline/physics_pipeline/substep.rs); the joints that it looks through once a motor
        // was set (`select_active_interactions` in dynamics/joint/impulse_joint/impulse_joint_set.rs); and the cursors of
        // its workers (`StageSync::new` in dynamics/solver/staged_island_solver/sync.rs). docs/performance.md says why
        // they stay. Its debug assertions make one more.
        let most = if cfg!(debug_assertions) { 5 } else { 4 };
        assert!(engine <= 200 * most, "{version}: {engine} allocations in 200 steps");
    }
}

#[test]
fn a_step_of_the_lander_allocates_only_inside_the_physics_engine() {
    let draws = LunarLander::draws(1);
    let terrain = Terrain::new(&draws.heights);
    let mut world = LanderWorld::new(&terrain, &Start::pushed(draws.force));
    let engine = allocations(25, |_| world.step(&[Push::default(); 2]));
    let mut flight = Flight::new(&draws, usize::MAX);
    let whole = allocations(25, |_| {
        flight.step([0.0; 2], [0.0; 2]);
    });
    assert_eq!(whole, engine, "the rules allocate");
    let mut env = serde_json::from_str::<EnvConfig>(r#"{"lunar-lander": {}}"#).unwrap().build().unwrap();
    env.reset(1).unwrap();
    let whole = allocations(25, |_| {
        env.step(&[0.0; 2]).unwrap();
    });
    assert_eq!(whole, engine, "the environment allocates");
    // Vectors of reduced coordinates that the engine allocates in every step.
    assert!(engine <= 25 * 40, "{engine} allocations in 25 steps");
}
