//! Vectors of 16 numbers for each instruction set, and the choice between them.
//!
//! Kernels are written once, generic over [`Simd`], and compiled for each instruction set inside [`run`]. All unsafe
//! code of the kernels is in this module, in its parts for each instruction set, and in [`super::tile`].
#![allow(unsafe_code)]

use std::cell::Cell;

#[cfg(target_arch = "x86_64")]
mod avx2;
#[cfg(target_arch = "x86_64")]
mod avx512;
mod portable;

#[cfg(target_arch = "x86_64")]
use avx2::Avx2;
#[cfg(target_arch = "x86_64")]
use avx512::Avx512;
use portable::Portable;

/// Numbers in a vector: one register of AVX-512, two of AVX2.
pub const LANES: usize = 16;

/// The numbers of a vector in memory.
pub type Lanes = [f32; LANES];

/// An instruction set that the kernels are compiled for. The bits of their results do not depend on it.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Path {
    /// AVX-512F: 32 registers of 16 numbers.
    Avx512,
    /// AVX2 and FMA: 16 registers of 8 numbers.
    Avx2,
    /// No vector instructions; slow without a fused multiply-add in hardware.
    Portable,
}

thread_local! {
    static FORCED: Cell<Option<Path>> = const { Cell::new(None) };
}

/// The paths that this machine can run, the fastest first.
pub fn paths() -> Vec<Path> {
    [Path::Avx512, Path::Avx2, Path::Portable].into_iter().filter(|path| is_supported(*path)).collect()
}

/// The path that kernels take on this thread: the fastest, or the one of [`forced`].
pub fn path() -> Path {
    FORCED.get().unwrap_or_else(|| match () {
        () if is_supported(Path::Avx512) => Path::Avx512,
        () if is_supported(Path::Avx2) => Path::Avx2,
        () => Path::Portable,
    })
}

/// Calls `call` while the kernels on this thread take `path`, or the fastest one where the machine cannot run it. For
/// tests and benchmarks.
pub fn forced<T>(path: Path, call: impl FnOnce() -> T) -> T {
    struct Reset(Option<Path>);
    impl Drop for Reset {
        fn drop(&mut self) {
            FORCED.set(self.0);
        }
    }
    let _reset = Reset(FORCED.replace(Some(path).filter(|path| is_supported(*path))));
    call()
}

/// Each feature that is found is cached by the standard library.
fn is_supported(path: Path) -> bool {
    match path {
        #[cfg(target_arch = "x86_64")]
        Path::Avx512 => is_x86_feature_detected!("avx512f") && is_supported(Path::Avx2),
        #[cfg(target_arch = "x86_64")]
        Path::Avx2 => is_x86_feature_detected!("avx2") && is_x86_feature_detected!("fma"),
        #[cfg(not(target_arch = "x86_64"))]
        Path::Avx512 | Path::Avx2 => false,
        Path::Portable => true,
    }
}

/// Something to be computed with vectors. `run` must be `#[inline(always)]`, as must be all that it calls with vectors:
/// only what is inlined into the functions of [`run`] is compiled for their instruction set.
pub trait Kernel {
    /// Computes it.
    fn run<S: Simd>(self, simd: S);
}

/// Computes `kernel` on the thread's [`path`].
pub fn run<K: Kernel>(kernel: K) {
    match path() {
        #[cfg(target_arch = "x86_64")]
        Path::Avx512 => {
            // SAFETY: `path` gives only paths that are supported.
            let simd = unsafe { Avx512::new() };
            simd.outlined(
                #[inline(always)]
                || kernel.run(simd),
            );
        }
        #[cfg(target_arch = "x86_64")]
        Path::Avx2 => {
            // SAFETY: `path` gives only paths that are supported.
            let simd = unsafe { Avx2::new() };
            simd.outlined(
                #[inline(always)]
                || kernel.run(simd),
            );
        }
        _ => kernel.run(Portable),
    }
}

/// Vectors of 16 numbers and of 8 in double precision. A value of the type proves that the machine has the instructions.
/// Every operation rounds correctly, as IEEE 754 has it.
pub trait Simd: Copy {
    /// 16 numbers.
    type V: Copy;
    /// 8 numbers in double precision.
    type D: Copy;
    /// Rows of a block of results, of at most [`Simd::COLUMNS`] vectors each, that fit the registers.
    const ROWS: usize;
    /// Vectors in such a row.
    const COLUMNS: usize;

    /// Calls `call` in a function of its own that is compiled for the instruction set: registers are allotted for each
    /// such function, and with many block sizes in one of them they would be allotted badly.
    fn outlined<F: FnOnce()>(self, call: F);

    /// 16 times the same number.
    fn splat(self, number: f32) -> Self::V;
    /// Reads a vector.
    fn load(self, from: &Lanes) -> Self::V;
    /// Writes a vector.
    fn store(self, vector: Self::V, to: &mut Lanes);
    /// Reads a vector.
    ///
    /// # Safety
    /// 16 numbers can be read at `from`.
    unsafe fn load_at(self, from: *const f32) -> Self::V;
    /// Asks for the cache line of a number, wherever it is; a hint that changes no result.
    fn prefetch(self, numbers: &[f32], at: usize);
    /// Bytes as numbers, 0..=255.
    fn bytes(self, from: &[u8; LANES]) -> Self::V;
    /// `a · b + c`, rounded once.
    fn mul_add(self, a: Self::V, b: Self::V, c: Self::V) -> Self::V;
    /// `a + b`.
    fn add(self, a: Self::V, b: Self::V) -> Self::V;
    /// `a − b`.
    fn sub(self, a: Self::V, b: Self::V) -> Self::V;
    /// `a · b`.
    fn mul(self, a: Self::V, b: Self::V) -> Self::V;
    /// `a / b`.
    fn div(self, a: Self::V, b: Self::V) -> Self::V;
    /// The square root.
    fn sqrt(self, a: Self::V) -> Self::V;
    /// 0 where a number is below 0, else the number, NaN included.
    fn relu(self, a: Self::V) -> Self::V;
    /// 0 where `output` is at most 0, else the number of `a`.
    fn where_positive(self, output: Self::V, a: Self::V) -> Self::V;
    /// The number of `a` where it is NaN, else that of `b`.
    fn nan_or(self, a: Self::V, b: Self::V) -> Self::V;
    /// Transposes 16 vectors.
    fn transpose(self, rows: [Self::V; LANES]) -> [Self::V; LANES];

    /// 8 times the same number.
    fn splat_d(self, number: f64) -> Self::D;
    /// The first and the last 8 numbers in double precision.
    fn widen(self, a: Self::V) -> [Self::D; 2];
    /// Rounds to single precision.
    fn narrow(self, halves: [Self::D; 2]) -> Self::V;
    /// `a · b + c`, rounded once.
    fn mul_add_d(self, a: Self::D, b: Self::D, c: Self::D) -> Self::D;
    /// `a + b`.
    fn add_d(self, a: Self::D, b: Self::D) -> Self::D;
    /// `a − b`.
    fn sub_d(self, a: Self::D, b: Self::D) -> Self::D;
    /// `a · b`.
    fn mul_d(self, a: Self::D, b: Self::D) -> Self::D;
    /// `a / b`.
    fn div_d(self, a: Self::D, b: Self::D) -> Self::D;
    /// Numbers within −`limit` to `limit`; NaN stays.
    fn clamp_d(self, a: Self::D, limit: f64) -> Self::D;
    /// The number with the bits `(bits of a + 1023) << 52`: where the low bits of `a` hold n, 2ⁿ.
    fn power_of_two_d(self, a: Self::D) -> Self::D;
}

/// The first [`LANES`] numbers of a slice, which has that many.
#[inline(always)]
pub fn lanes(numbers: &[f32]) -> &Lanes {
    &numbers.as_chunks().0[0]
}

/// As [`lanes`], to be changed.
#[inline(always)]
pub fn lanes_mut(numbers: &mut [f32]) -> &mut Lanes {
    &mut numbers.as_chunks_mut().0[0]
}

/// Up to [`LANES`] numbers, followed by zeros.
#[inline(always)]
pub fn padded(numbers: &[f32]) -> Lanes {
    let mut lanes = [0.0; LANES];
    lanes[..numbers.len()].copy_from_slice(numbers);
    lanes
}

/// Reads up to [`LANES`] numbers, followed by zeros.
#[inline(always)]
pub fn load_some<S: Simd>(simd: S, numbers: &[f32]) -> S::V {
    match numbers.first_chunk() {
        Some(lanes) => simd.load(lanes),
        None => simd.load(&padded(numbers)),
    }
}

/// Writes the first numbers of a vector, as many as `numbers` has room for.
#[inline(always)]
pub fn store_some<S: Simd>(simd: S, vector: S::V, numbers: &mut [f32]) {
    match numbers.first_chunk_mut() {
        Some(lanes) => simd.store(vector, lanes),
        None => {
            let mut lanes = [0.0; LANES];
            simd.store(vector, &mut lanes);
            numbers.copy_from_slice(&lanes[..numbers.len()]);
        }
    }
}
