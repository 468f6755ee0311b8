//! Equal seeds give equal bytes, whatever else runs beside: each algorithm trains twice, alone and beside neighbours that
//! keep every processor busy, one of them with a training of its own.

use std::sync::atomic::{AtomicBool, Ordering::Relaxed};

use dril_stage_api::testing::Bench;

use crate::worlds::{self, World, digests};

fn equal_beside_neighbours(make: impl Fn() -> Bench) {
    let alone = make();
    alone.run().unwrap();
    let alone = digests(&alone);
    let over = AtomicBool::new(false);
    let beside = std::thread::scope(|scope| {
        let threads = std::thread::available_parallelism().map_or(2, usize::from);
        for _ in 0..threads {
            scope.spawn(|| {
                let mut number = 0_u64;
                while !over.load(Relaxed) {
                    number = std::hint::black_box(number.wrapping_mul(6_364_136_223_846_793_005) + 1);
                }
            });
        }
        let neighbour = scope.spawn(|| {
            while !over.load(Relaxed) {
                worlds::bc(3).run().unwrap();
            }
        });
        let bench = make();
        let ran = bench.run();
        over.store(true, Relaxed);
        neighbour.join().unwrap();
        ran.unwrap();
        digests(&bench)
    });
    assert_eq!(beside, alone);
}

#[test]
fn ppo_gives_equal_bytes_beside_busy_neighbours() {
    equal_beside_neighbours(|| worlds::ppo(2));
}

#[test]
fn behaviour_cloning_gives_equal_bytes_beside_busy_neighbours() {
    equal_beside_neighbours(|| worlds::bc(10));
}

#[test]
fn an_ensemble_gives_equal_bytes_beside_busy_neighbours() {
    equal_beside_neighbours(|| worlds::ensemble(10));
}

#[test]
fn dril_gives_equal_bytes_beside_busy_neighbours() {
    let world = World::make();
    equal_beside_neighbours(|| world.dril(2));
}
