//! Vectors of AVX2 and FMA, two registers each.
#![allow(unsafe_code)]
#![allow(
    clippy::undocumented_unsafe_blocks,
    reason = "one reason for all: a value of `Avx2` proves AVX2 and FMA"
)]

use std::arch::x86_64::*;

use super::{LANES, Lanes, Simd};

/// Proves that the machine has AVX2 and FMA.
#[derive(Clone, Copy, Debug)]
pub struct Avx2(());

impl Avx2 {
    /// # Safety
    /// The machine has AVX2 and FMA.
    pub unsafe fn new() -> Self {
        Self(())
    }
}

#[target_feature(enable = "avx2,fma")]
#[inline(never)]
fn outlined<F: FnOnce()>(call: F) {
    call();
}

/// 16 numbers.
type V = [__m256; 2];
/// 8 numbers in double precision.
type D = [__m256d; 2];

#[inline(always)]
fn transpose8(r: [__m256; 8]) -> [__m256; 8] {
    let pd = |a: __m256| unsafe { _mm256_castps_pd(a) };
    let ps = |a: __m256d| unsafe { _mm256_castpd_ps(a) };
    let mut out = r;
    unsafe {
        // In `quads[4 g + c]`, the c-th number of each half, of the rows 4 g to 4 g + 3.
        let mut quads = r;
        for g in 0..2 {
            let (a, b) =
                (_mm256_unpacklo_ps(r[4 * g], r[4 * g + 1]), _mm256_unpackhi_ps(r[4 * g], r[4 * g + 1]));
            let (c, d) = (
                _mm256_unpacklo_ps(r[4 * g + 2], r[4 * g + 3]),
                _mm256_unpackhi_ps(r[4 * g + 2], r[4 * g + 3]),
            );
            quads[4 * g] = ps(_mm256_unpacklo_pd(pd(a), pd(c)));
            quads[4 * g + 1] = ps(_mm256_unpackhi_pd(pd(a), pd(c)));
            quads[4 * g + 2] = ps(_mm256_unpacklo_pd(pd(b), pd(d)));
            quads[4 * g + 3] = ps(_mm256_unpackhi_pd(pd(b), pd(d)));
        }
        for c in 0..4 {
            out[c] = _mm256_permute2f128_ps::<0x20>(quads[c], quads[4 + c]);
            out[4 + c] = _mm256_permute2f128_ps::<0x31>(quads[c], quads[4 + c]);
        }
    }
    out
}

impl Simd for Avx2 {
    type V = V;
    type D = D;
    const ROWS: usize = 6;
    const COLUMNS: usize = 1;

    #[inline(always)]
    fn outlined<F: FnOnce()>(self, call: F) {
        unsafe { outlined(call) }
    }
    #[inline(always)]
    fn splat(self, number: f32) -> V {
        unsafe { [_mm256_set1_ps(number); 2] }
    }
    #[inline(always)]
    fn load(self, from: &Lanes) -> V {
        unsafe { [_mm256_loadu_ps(from.as_ptr()), _mm256_loadu_ps(from.as_ptr().add(8))] }
    }
    #[inline(always)]
    fn store(self, [first, last]: V, to: &mut Lanes) {
        unsafe {
            _mm256_storeu_ps(to.as_mut_ptr(), first);
            _mm256_storeu_ps(to.as_mut_ptr().add(8), last);
        }
    }
    #[inline(always)]
    unsafe fn load_at(self, from: *const f32) -> V {
        unsafe { [_mm256_loadu_ps(from), _mm256_loadu_ps(from.add(8))] }
    }
    #[inline(always)]
    fn prefetch(self, numbers: &[f32], at: usize) {
        unsafe { _mm_prefetch::<_MM_HINT_T1>(numbers.as_ptr().wrapping_add(at).cast()) }
    }
    #[inline(always)]
    fn bytes(self, from: &[u8; LANES]) -> V {
        unsafe {
            let bytes = _mm_loadu_si128(from.as_ptr().cast());
            let last = _mm_srli_si128::<8>(bytes);
            [_mm256_cvtepi32_ps(_mm256_cvtepu8_epi32(bytes)), _mm256_cvtepi32_ps(_mm256_cvtepu8_epi32(last))]
        }
    }
    #[inline(always)]
    fn mul_add(self, a: V, b: V, c: V) -> V {
        unsafe { [_mm256_fmadd_ps(a[0], b[0], c[0]), _mm256_fmadd_ps(a[1], b[1], c[1])] }
    }
    #[inline(always)]
    fn add(self, a: V, b: V) -> V {
        unsafe { [_mm256_add_ps(a[0], b[0]), _mm256_add_ps(a[1], b[1])] }
    }
    #[inline(always)]
    fn sub(self, a: V, b: V) -> V {
        unsafe { [_mm256_sub_ps(a[0], b[0]), _mm256_sub_ps(a[1], b[1])] }
    }
    #[inline(always)]
    fn mul(self, a: V, b: V) -> V {
        unsafe { [_mm256_mul_ps(a[0], b[0]), _mm256_mul_ps(a[1], b[1])] }
    }
    #[inline(always)]
    fn div(self, a: V, b: V) -> V {
        unsafe { [_mm256_div_ps(a[0], b[0]), _mm256_div_ps(a[1], b[1])] }
    }
    #[inline(always)]
    fn sqrt(self, a: V) -> V {
        unsafe { [_mm256_sqrt_ps(a[0]), _mm256_sqrt_ps(a[1])] }
    }
    #[inline(always)]
    fn relu(self, a: V) -> V {
        // The second operand is the result where one is NaN.
        unsafe { [_mm256_max_ps(_mm256_setzero_ps(), a[0]), _mm256_max_ps(_mm256_setzero_ps(), a[1])] }
    }
    #[inline(always)]
    fn where_positive(self, output: V, a: V) -> V {
        unsafe {
            let passes = |output| _mm256_cmp_ps::<_CMP_NLE_UQ>(output, _mm256_setzero_ps());
            [_mm256_and_ps(passes(output[0]), a[0]), _mm256_and_ps(passes(output[1]), a[1])]
        }
    }
    #[inline(always)]
    fn nan_or(self, a: V, b: V) -> V {
        unsafe {
            let half = |a, b| _mm256_blendv_ps(b, a, _mm256_cmp_ps::<_CMP_UNORD_Q>(a, a));
            [half(a[0], b[0]), half(a[1], b[1])]
        }
    }
    #[inline(always)]
    fn transpose(self, rows: [V; LANES]) -> [V; LANES] {
        let mut out = rows;
        for side in 0..2 {
            for half in 0..2 {
                let mut square = [rows[0][0]; 8];
                for r in 0..8 {
                    square[r] = rows[8 * half + r][side];
                }
                let square = transpose8(square);
                for r in 0..8 {
                    out[8 * side + r][half] = square[r];
                }
            }
        }
        out
    }

    #[inline(always)]
    fn splat_d(self, number: f64) -> D {
        unsafe { [_mm256_set1_pd(number); 2] }
    }
    #[inline(always)]
    fn widen(self, a: V) -> [D; 2] {
        unsafe {
            let half = |a| {
                [_mm256_cvtps_pd(_mm256_castps256_ps128(a)), _mm256_cvtps_pd(_mm256_extractf128_ps::<1>(a))]
            };
            [half(a[0]), half(a[1])]
        }
    }
    #[inline(always)]
    fn narrow(self, halves: [D; 2]) -> V {
        unsafe {
            let half = |d: D| _mm256_set_m128(_mm256_cvtpd_ps(d[1]), _mm256_cvtpd_ps(d[0]));
            [half(halves[0]), half(halves[1])]
        }
    }
    #[inline(always)]
    fn mul_add_d(self, a: D, b: D, c: D) -> D {
        unsafe { [_mm256_fmadd_pd(a[0], b[0], c[0]), _mm256_fmadd_pd(a[1], b[1], c[1])] }
    }
    #[inline(always)]
    fn add_d(self, a: D, b: D) -> D {
        unsafe { [_mm256_add_pd(a[0], b[0]), _mm256_add_pd(a[1], b[1])] }
    }
    #[inline(always)]
    fn sub_d(self, a: D, b: D) -> D {
        unsafe { [_mm256_sub_pd(a[0], b[0]), _mm256_sub_pd(a[1], b[1])] }
    }
    #[inline(always)]
    fn mul_d(self, a: D, b: D) -> D {
        unsafe { [_mm256_mul_pd(a[0], b[0]), _mm256_mul_pd(a[1], b[1])] }
    }
    #[inline(always)]
    fn div_d(self, a: D, b: D) -> D {
        unsafe { [_mm256_div_pd(a[0], b[0]), _mm256_div_pd(a[1], b[1])] }
    }
    #[inline(always)]
    fn clamp_d(self, a: D, limit: f64) -> D {
        unsafe {
            // The second operand is the result where one is NaN.
            let (low, high) = (_mm256_set1_pd(-limit), _mm256_set1_pd(limit));
            let half = |a| _mm256_min_pd(high, _mm256_max_pd(low, a));
            [half(a[0]), half(a[1])]
        }
    }
    #[inline(always)]
    fn power_of_two_d(self, a: D) -> D {
        unsafe {
            let half = |a| {
                let sum = _mm256_add_epi64(_mm256_castpd_si256(a), _mm256_set1_epi64x(1023));
                _mm256_castsi256_pd(_mm256_slli_epi64::<52>(sum))
            };
            [half(a[0]), half(a[1])]
        }
    }
}
