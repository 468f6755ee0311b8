//! What a core of this machine can compute at most, for each path of the kernels: the measure of the other figures.
#![allow(unsafe_code)]
#![allow(dead_code, reason = "each bench is a program of its own and uses a part of this")]

use std::hint::black_box;
use std::time::Instant;

use dril_learn::kernels::{Path, forced};

/// Sums side by side in the loops below: enough for two multipliers that take four cycles, or for one that takes more.
const SUMS: usize = 12;

/// Steps of such a loop.
const STEPS: usize = 1_000_000;

/// Billions of operations a second of processor time, where a fused multiply-add counts as two: a loop of nothing else,
/// in registers. The best of `spells`.
pub fn peak(path: Path, spells: usize) -> f64 {
    let lanes = match path {
        Path::Avx512 => 16,
        Path::Avx2 => 8,
        Path::Portable => 1,
    };
    per_cpu_second(spells, || multiply(path)) * (STEPS * SUMS * lanes * 2) as f64 * 1e-9
}

fn multiply(path: Path) {
    forced(path, || match path {
        #[cfg(target_arch = "x86_64")]
        Path::Avx512 => {
            // SAFETY: benchmarks run the paths of `kernels::paths` only.
            unsafe { x86::avx512() }
        }
        #[cfg(target_arch = "x86_64")]
        Path::Avx2 => {
            // SAFETY: as above.
            unsafe { x86::avx2() }
        }
        _ => {
            let (mut sums, by, plus) = (black_box([0.5_f32; SUMS]), black_box(0.999), black_box(0.001));
            for _ in 0..STEPS {
                for sum in &mut sums {
                    *sum = sum.mul_add(by, plus);
                }
            }
            black_box(sums);
        }
    });
}

#[cfg(target_arch = "x86_64")]
mod x86 {
    use super::{STEPS, SUMS};
    use std::arch::x86_64::*;
    use std::hint::black_box;

    #[target_feature(enable = "avx512f")]
    pub fn avx512() {
        let (mut sums, by) = (black_box([_mm512_set1_ps(0.5); SUMS]), _mm512_set1_ps(black_box(0.999)));
        let plus = _mm512_set1_ps(black_box(0.001));
        for _ in 0..STEPS {
            for sum in &mut sums {
                *sum = _mm512_fmadd_ps(*sum, by, plus);
            }
        }
        black_box(sums);
    }

    #[target_feature(enable = "avx2,fma")]
    pub fn avx2() {
        let (mut sums, by) = (black_box([_mm256_set1_ps(0.5); SUMS]), _mm256_set1_ps(black_box(0.999)));
        let plus = _mm256_set1_ps(black_box(0.001));
        for _ in 0..STEPS {
            for sum in &mut sums {
                *sum = _mm256_fmadd_ps(*sum, by, plus);
            }
        }
        black_box(sums);
    }
}

/// Seconds of processor time of each spell.
const SPELL: f64 = 0.1;

/// Calls a second of processor time: the best of `spells`, since neighbours can only take away.
pub fn per_cpu_second(spells: usize, mut call: impl FnMut()) -> f64 {
    call();
    let mut best = 0.0_f64;
    for _ in 0..spells {
        let (from, mut calls) = (cpu_seconds(), 0);
        while cpu_seconds() - from < SPELL {
            call();
            calls += 1;
        }
        best = best.max(f64::from(calls) / (cpu_seconds() - from));
    }
    best
}

/// Processor time of this program, in seconds; the clock's where the system does not count it.
pub fn cpu_seconds() -> f64 {
    let mut time = libc::timespec { tv_sec: 0, tv_nsec: 0 };
    // SAFETY: the call only writes the time into the struct given.
    let failed = unsafe { libc::clock_gettime(libc::CLOCK_PROCESS_CPUTIME_ID, &raw mut time) } != 0;
    if failed {
        static START: std::sync::OnceLock<Instant> = std::sync::OnceLock::new();
        return START.get_or_init(Instant::now).elapsed().as_secs_f64();
    }
    time.tv_sec as f64 + time.tv_nsec as f64 * 1e-9
}
