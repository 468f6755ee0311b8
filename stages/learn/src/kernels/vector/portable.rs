//! Vectors without vector instructions: the reference that the others are tested against, and what other processors
//! than x86-64 run.
#![allow(unsafe_code)]

use std::array::from_fn;

use super::{LANES, Lanes, Simd};

/// Every machine has these.
#[derive(Clone, Copy, Debug)]
pub struct Portable;

/// 8 numbers in double precision.
type D = [f64; 8];

impl Simd for Portable {
    type V = Lanes;
    type D = D;
    const ROWS: usize = 4;
    const COLUMNS: usize = 1;

    #[inline(always)]
    fn outlined<F: FnOnce()>(self, call: F) {
        call();
    }
    #[inline(always)]
    fn splat(self, number: f32) -> Lanes {
        [number; LANES]
    }
    #[inline(always)]
    fn load(self, from: &Lanes) -> Lanes {
        *from
    }
    #[inline(always)]
    fn store(self, vector: Lanes, to: &mut Lanes) {
        *to = vector;
    }
    #[inline(always)]
    unsafe fn load_at(self, from: *const f32) -> Lanes {
        // SAFETY: 16 numbers can be read there.
        unsafe { from.cast::<Lanes>().read_unaligned() }
    }
    #[inline(always)]
    fn prefetch(self, _numbers: &[f32], _at: usize) {}
    #[inline(always)]
    fn bytes(self, from: &[u8; LANES]) -> Lanes {
        from_fn(|lane| f32::from(from[lane]))
    }
    #[inline(always)]
    fn mul_add(self, a: Lanes, b: Lanes, c: Lanes) -> Lanes {
        from_fn(|lane| a[lane].mul_add(b[lane], c[lane]))
    }
    #[inline(always)]
    fn add(self, a: Lanes, b: Lanes) -> Lanes {
        from_fn(|lane| a[lane] + b[lane])
    }
    #[inline(always)]
    fn sub(self, a: Lanes, b: Lanes) -> Lanes {
        from_fn(|lane| a[lane] - b[lane])
    }
    #[inline(always)]
    fn mul(self, a: Lanes, b: Lanes) -> Lanes {
        from_fn(|lane| a[lane] * b[lane])
    }
    #[inline(always)]
    fn div(self, a: Lanes, b: Lanes) -> Lanes {
        from_fn(|lane| a[lane] / b[lane])
    }
    #[inline(always)]
    fn sqrt(self, a: Lanes) -> Lanes {
        a.map(f32::sqrt)
    }
    #[inline(always)]
    fn relu(self, a: Lanes) -> Lanes {
        // Not `f32::max`, which makes a number of NaN.
        a.map(|number| if 0.0 > number { 0.0 } else { number })
    }
    #[inline(always)]
    fn where_positive(self, output: Lanes, a: Lanes) -> Lanes {
        from_fn(|lane| if output[lane] <= 0.0 { 0.0 } else { a[lane] })
    }
    #[inline(always)]
    fn nan_or(self, a: Lanes, b: Lanes) -> Lanes {
        from_fn(|lane| if a[lane].is_nan() { a[lane] } else { b[lane] })
    }
    #[inline(always)]
    fn transpose(self, rows: [Lanes; LANES]) -> [Lanes; LANES] {
        from_fn(|column| from_fn(|row| rows[row][column]))
    }

    #[inline(always)]
    fn splat_d(self, number: f64) -> D {
        [number; 8]
    }
    #[inline(always)]
    fn widen(self, a: Lanes) -> [D; 2] {
        from_fn(|half| from_fn(|lane| f64::from(a[8 * half + lane])))
    }
    #[inline(always)]
    fn narrow(self, halves: [D; 2]) -> Lanes {
        from_fn(|lane| halves[lane / 8][lane % 8] as f32)
    }
    #[inline(always)]
    fn mul_add_d(self, a: D, b: D, c: D) -> D {
        from_fn(|lane| a[lane].mul_add(b[lane], c[lane]))
    }
    #[inline(always)]
    fn add_d(self, a: D, b: D) -> D {
        from_fn(|lane| a[lane] + b[lane])
    }
    #[inline(always)]
    fn sub_d(self, a: D, b: D) -> D {
        from_fn(|lane| a[lane] - b[lane])
    }
    #[inline(always)]
    fn mul_d(self, a: D, b: D) -> D {
        from_fn(|lane| a[lane] * b[lane])
    }
    #[inline(always)]
    fn div_d(self, a: D, b: D) -> D {
        from_fn(|lane| a[lane] / b[lane])
    }
    #[inline(always)]
    fn clamp_d(self, a: D, limit: f64) -> D {
        a.map(|number| number.clamp(-limit, limit))
    }
    #[inline(always)]
    fn power_of_two_d(self, a: D) -> D {
        a.map(|number| f64::from_bits(number.to_bits().wrapping_add(1023) << 52))
    }
}
