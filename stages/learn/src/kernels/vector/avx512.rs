//! Vectors of AVX-512F.
#![allow(unsafe_code)]
#![allow(
    clippy::undocumented_unsafe_blocks,
    reason = "one reason for all: a value of `Avx512` proves AVX-512F"
)]

use std::arch::x86_64::*;

use super::{LANES, Lanes, Simd};

/// Proves that the machine has AVX-512F.
#[derive(Clone, Copy, Debug)]
pub struct Avx512(());

impl Avx512 {
    /// # Safety
    /// The machine has AVX-512F.
    pub unsafe fn new() -> Self {
        Self(())
    }
}

#[target_feature(enable = "avx512f,avx2,fma")]
#[inline(never)]
fn outlined<F: FnOnce()>(call: F) {
    call();
}

impl Simd for Avx512 {
    type V = __m512;
    type D = __m512d;
    const ROWS: usize = 12;
    const COLUMNS: usize = 2;

    #[inline(always)]
    fn outlined<F: FnOnce()>(self, call: F) {
        unsafe { outlined(call) }
    }
    #[inline(always)]
    fn splat(self, number: f32) -> __m512 {
        unsafe { _mm512_set1_ps(number) }
    }
    #[inline(always)]
    fn load(self, from: &Lanes) -> __m512 {
        unsafe { _mm512_loadu_ps(from.as_ptr()) }
    }
    #[inline(always)]
    fn store(self, vector: __m512, to: &mut Lanes) {
        unsafe { _mm512_storeu_ps(to.as_mut_ptr(), vector) }
    }
    #[inline(always)]
    unsafe fn load_at(self, from: *const f32) -> __m512 {
        unsafe { _mm512_loadu_ps(from) }
    }
    #[inline(always)]
    fn prefetch(self, numbers: &[f32], at: usize) {
        unsafe { _mm_prefetch::<_MM_HINT_T1>(numbers.as_ptr().wrapping_add(at).cast()) }
    }
    #[inline(always)]
    fn bytes(self, from: &[u8; LANES]) -> __m512 {
        unsafe { _mm512_cvtepi32_ps(_mm512_cvtepu8_epi32(_mm_loadu_si128(from.as_ptr().cast()))) }
    }
    #[inline(always)]
    fn mul_add(self, a: __m512, b: __m512, c: __m512) -> __m512 {
        unsafe { _mm512_fmadd_ps(a, b, c) }
    }
    #[inline(always)]
    fn add(self, a: __m512, b: __m512) -> __m512 {
        unsafe { _mm512_add_ps(a, b) }
    }
    #[inline(always)]
    fn sub(self, a: __m512, b: __m512) -> __m512 {
        unsafe { _mm512_sub_ps(a, b) }
    }
    #[inline(always)]
    fn mul(self, a: __m512, b: __m512) -> __m512 {
        unsafe { _mm512_mul_ps(a, b) }
    }
    #[inline(always)]
    fn div(self, a: __m512, b: __m512) -> __m512 {
        unsafe { _mm512_div_ps(a, b) }
    }
    #[inline(always)]
    fn sqrt(self, a: __m512) -> __m512 {
        unsafe { _mm512_sqrt_ps(a) }
    }
    #[inline(always)]
    fn relu(self, a: __m512) -> __m512 {
        // The second operand is the result where one is NaN.
        unsafe { _mm512_max_ps(_mm512_setzero_ps(), a) }
    }
    #[inline(always)]
    fn where_positive(self, output: __m512, a: __m512) -> __m512 {
        unsafe {
            let passes = _mm512_cmp_ps_mask::<_CMP_NLE_UQ>(output, _mm512_setzero_ps());
            _mm512_maskz_mov_ps(passes, a)
        }
    }
    #[inline(always)]
    fn nan_or(self, a: __m512, b: __m512) -> __m512 {
        unsafe { _mm512_mask_mov_ps(b, _mm512_cmp_ps_mask::<_CMP_UNORD_Q>(a, a), a) }
    }
    #[inline(always)]
    fn transpose(self, r: [__m512; LANES]) -> [__m512; LANES] {
        let pd = |a: __m512| unsafe { _mm512_castps_pd(a) };
        let ps = |a: __m512d| unsafe { _mm512_castpd_ps(a) };
        let mut out = r;
        unsafe {
            // In `quads[4 g + c]`, the c-th number of each quarter, of the rows 4 g to 4 g + 3.
            let mut quads = r;
            for g in 0..4 {
                let (a, b) =
                    (_mm512_unpacklo_ps(r[4 * g], r[4 * g + 1]), _mm512_unpackhi_ps(r[4 * g], r[4 * g + 1]));
                let (c, d) = (
                    _mm512_unpacklo_ps(r[4 * g + 2], r[4 * g + 3]),
                    _mm512_unpackhi_ps(r[4 * g + 2], r[4 * g + 3]),
                );
                quads[4 * g] = ps(_mm512_unpacklo_pd(pd(a), pd(c)));
                quads[4 * g + 1] = ps(_mm512_unpackhi_pd(pd(a), pd(c)));
                quads[4 * g + 2] = ps(_mm512_unpacklo_pd(pd(b), pd(d)));
                quads[4 * g + 3] = ps(_mm512_unpackhi_pd(pd(b), pd(d)));
            }
            for c in 0..4 {
                let even = _mm512_shuffle_f32x4::<0x88>(quads[c], quads[4 + c]);
                let odd = _mm512_shuffle_f32x4::<0xdd>(quads[c], quads[4 + c]);
                let low_even = _mm512_shuffle_f32x4::<0x88>(quads[8 + c], quads[12 + c]);
                let low_odd = _mm512_shuffle_f32x4::<0xdd>(quads[8 + c], quads[12 + c]);
                out[c] = _mm512_shuffle_f32x4::<0x88>(even, low_even);
                out[4 + c] = _mm512_shuffle_f32x4::<0x88>(odd, low_odd);
                out[8 + c] = _mm512_shuffle_f32x4::<0xdd>(even, low_even);
                out[12 + c] = _mm512_shuffle_f32x4::<0xdd>(odd, low_odd);
            }
        }
        out
    }

    #[inline(always)]
    fn splat_d(self, number: f64) -> __m512d {
        unsafe { _mm512_set1_pd(number) }
    }
    #[inline(always)]
    fn widen(self, a: __m512) -> [__m512d; 2] {
        unsafe {
            let last = _mm256_castpd_ps(_mm512_extractf64x4_pd::<1>(_mm512_castps_pd(a)));
            [_mm512_cvtps_pd(_mm512_castps512_ps256(a)), _mm512_cvtps_pd(last)]
        }
    }
    #[inline(always)]
    fn narrow(self, [first, last]: [__m512d; 2]) -> __m512 {
        unsafe {
            let first = _mm512_castps_pd(_mm512_castps256_ps512(_mm512_cvtpd_ps(first)));
            let last = _mm256_castps_pd(_mm512_cvtpd_ps(last));
            _mm512_castpd_ps(_mm512_insertf64x4::<1>(first, last))
        }
    }
    #[inline(always)]
    fn mul_add_d(self, a: __m512d, b: __m512d, c: __m512d) -> __m512d {
        unsafe { _mm512_fmadd_pd(a, b, c) }
    }
    #[inline(always)]
    fn add_d(self, a: __m512d, b: __m512d) -> __m512d {
        unsafe { _mm512_add_pd(a, b) }
    }
    #[inline(always)]
    fn sub_d(self, a: __m512d, b: __m512d) -> __m512d {
        unsafe { _mm512_sub_pd(a, b) }
    }
    #[inline(always)]
    fn mul_d(self, a: __m512d, b: __m512d) -> __m512d {
        unsafe { _mm512_mul_pd(a, b) }
    }
    #[inline(always)]
    fn div_d(self, a: __m512d, b: __m512d) -> __m512d {
        unsafe { _mm512_div_pd(a, b) }
    }
    #[inline(always)]
    fn clamp_d(self, a: __m512d, limit: f64) -> __m512d {
        // The second operand is the result where one is NaN.
        unsafe { _mm512_min_pd(_mm512_set1_pd(limit), _mm512_max_pd(_mm512_set1_pd(-limit), a)) }
    }
    #[inline(always)]
    fn power_of_two_d(self, a: __m512d) -> __m512d {
        unsafe {
            let sum = _mm512_add_epi64(_mm512_castpd_si512(a), _mm512_set1_epi64(1023));
            _mm512_castsi512_pd(_mm512_slli_epi64::<52>(sum))
        }
    }
}
