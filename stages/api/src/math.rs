//! Elementary and special functions whose bits are the same on every machine.
//!
//! `f64::exp` and similar functions call the C library, which selects its code by the processor at run time, as vector
//! libraries do; their last bits differ between machines. Code that affects a result or a cache key uses this module
//! instead. The functions are those of the crate `libm` (musl's and FreeBSD's algorithms in plain
//! Rust). It uses IEEE additions, multiplications and divisions in a fixed order, which no compiler may reorder or fuse.
//! On x86-64, only its `fma` depends on the processor, and its result is correctly rounded either way; `sqrt` is the
//! instruction, which is correctly rounded too. The version is pinned.
//!
//! Safe without this module, because IEEE 754 or Rust define every bit: `+ - * /`, `sqrt`, `mul_add`, `abs`, `floor`,
//! `ceil`, `round`, `trunc`, `min`, `max`, `clamp`, `rem_euclid` and conversions.

use std::f64::consts::PI;

/// eˣ.
pub fn exp(x: f64) -> f64 {
    libm::exp(x)
}

/// eˣ − 1, accurate near 0.
pub fn exp_m1(x: f64) -> f64 {
    libm::expm1(x)
}

/// The natural logarithm.
pub fn ln(x: f64) -> f64 {
    libm::log(x)
}

/// ln(1 + x), accurate near 0.
pub fn ln_1p(x: f64) -> f64 {
    libm::log1p(x)
}

/// The logarithm to base 10.
pub fn log10(x: f64) -> f64 {
    libm::log10(x)
}

/// x to the power of y.
pub fn pow(x: f64, y: f64) -> f64 {
    libm::pow(x, y)
}

/// The sine of an angle in radians.
pub fn sin(x: f64) -> f64 {
    libm::sin(x)
}

/// The cosine of an angle in radians.
pub fn cos(x: f64) -> f64 {
    libm::cos(x)
}

/// Sine and cosine of an angle in radians.
pub fn sin_cos(x: f64) -> (f64, f64) {
    libm::sincos(x)
}

/// The tangent of an angle in radians.
pub fn tan(x: f64) -> f64 {
    libm::tan(x)
}

/// The angle of the point (x, y) in radians, in [−π, π].
pub fn atan2(y: f64, x: f64) -> f64 {
    libm::atan2(y, x)
}

/// The hyperbolic tangent.
pub fn tanh(x: f64) -> f64 {
    libm::tanh(x)
}

/// √(x² + y²) without overflow on the way.
pub fn hypot(x: f64, y: f64) -> f64 {
    libm::hypot(x, y)
}

/// eˣ in single precision.
pub fn expf(x: f32) -> f32 {
    libm::expf(x)
}

/// The natural logarithm in single precision.
pub fn lnf(x: f32) -> f32 {
    libm::logf(x)
}

/// The sine of an angle in radians, in single precision.
pub fn sinf(x: f32) -> f32 {
    libm::sinf(x)
}

/// The cosine of an angle in radians, in single precision.
pub fn cosf(x: f32) -> f32 {
    libm::cosf(x)
}

/// Sine and cosine of an angle in radians, in single precision.
pub fn sin_cosf(x: f32) -> (f32, f32) {
    libm::sincosf(x)
}

/// The angle of the point (x, y) in radians, in single precision.
pub fn atan2f(y: f32, x: f32) -> f32 {
    libm::atan2f(y, x)
}

/// The hyperbolic tangent in single precision.
pub fn tanhf(x: f32) -> f32 {
    libm::tanhf(x)
}

/// √(x² + y²) in single precision.
pub fn hypotf(x: f32, y: f32) -> f32 {
    libm::hypotf(x, y)
}

/// ln(1 + eˣ): a smooth version of max(x, 0).
pub fn softplus(x: f64) -> f64 {
    // e^−|x| is at most 1, so nothing overflows.
    x.max(0.0) + ln_1p(exp(-x.abs()))
}

/// 1 / (1 + e⁻ˣ): the derivative of [`softplus`].
pub fn logistic(x: f64) -> f64 {
    let small = exp(-x.abs());
    if x < 0.0 { small / (1.0 + small) } else { 1.0 / (1.0 + small) }
}

/// ln Γ(x) for x > 0.
pub fn ln_gamma(x: f64) -> f64 {
    libm::lgamma(x)
}

/// Above this, the truncation error of the asymptotic series is below the rounding error.
const ASYMPTOTIC: f64 = 10.0;

/// ψ(x) = d ln Γ(x) / dx for x > 0; NaN elsewhere.
///
/// ψ(x) = ψ(x + 1) − 1/x up to 10, then the asymptotic series (Abramowitz and Stegun 6.3.18).
pub fn digamma(x: f64) -> f64 {
    if x.is_nan() || x <= 0.0 {
        return f64::NAN;
    }
    let (mut at, mut below) = (x, 0.0);
    while at < ASYMPTOTIC {
        below += 1.0 / at;
        at += 1.0;
    }
    ln(at) - digamma_remainder(at) - below
}

/// ln x − ψ(x) for x ≥ 10: 1/2x + Σ B₂ₖ / (2k x²ᵏ).
fn digamma_remainder(x: f64) -> f64 {
    let inverse = 1.0 / x;
    const TERMS: [f64; 7] =
        [1.0 / 12.0, -1.0 / 120.0, 1.0 / 252.0, -1.0 / 240.0, 1.0 / 132.0, -691.0 / 32_760.0, 1.0 / 12.0];
    let square = inverse * inverse;
    0.5 * inverse + square * polynomial(&TERMS, square)
}

/// ψ′(x), the second derivative of ln Γ, for x > 0; NaN elsewhere.
///
/// ψ′(x) = ψ′(x + 1) + 1/x² up to 10, then the asymptotic series (Abramowitz and Stegun 6.4.11).
pub fn trigamma(x: f64) -> f64 {
    if x.is_nan() || x <= 0.0 {
        return f64::NAN;
    }
    let (mut at, mut below) = (x, 0.0);
    while at < ASYMPTOTIC {
        below += 1.0 / (at * at);
        at += 1.0;
    }
    const TERMS: [f64; 8] = [
        1.0 / 6.0,
        -1.0 / 30.0,
        1.0 / 42.0,
        -1.0 / 30.0,
        5.0 / 66.0,
        -691.0 / 2_730.0,
        7.0 / 6.0,
        -3_617.0 / 510.0,
    ];
    let inverse = 1.0 / at;
    let square = inverse * inverse;
    below + inverse * (1.0 + 0.5 * inverse + square * polynomial(&TERMS, square))
}

/// ln B(a, b) = ln Γ(a) + ln Γ(b) − ln Γ(a + b) for a, b > 0, without the cancellation of that form where an argument
/// is large: there the three logarithms are expanded by Stirling's formula and their large parts are combined
/// (Didonato and Morris 1992, algorithm 708).
pub fn ln_beta(a: f64, b: f64) -> f64 {
    let (small, large) = if a < b { (a, b) } else { (b, a) };
    if large < ASYMPTOTIC {
        return ln_gamma(small) + ln_gamma(large) - ln_gamma(small + large);
    }
    let sum = small + large;
    if small < ASYMPTOTIC {
        // ln Γ(large) − ln Γ(sum).
        let quotient = small - (sum - 0.5) * ln_1p(small / large) - small * ln(large)
            + (stirling_remainder(large) - stirling_remainder(sum));
        return ln_gamma(small) + quotient;
    }
    let remainder = stirling_remainder(small) + stirling_remainder(large) - stirling_remainder(sum);
    0.5 * ln(2.0 * PI) - 0.5 * ln(large) + remainder + (small - 0.5) * ln(small / sum)
        - large * ln_1p(small / large)
}

/// ln Γ(x) − [(x − ½) ln x − x + ½ ln 2π] for x ≥ 10: Σ B₂ₖ / (2k (2k − 1) x²ᵏ⁻¹).
fn stirling_remainder(x: f64) -> f64 {
    const TERMS: [f64; 7] = [
        1.0 / 12.0,
        -1.0 / 360.0,
        1.0 / 1_260.0,
        -1.0 / 1_680.0,
        1.0 / 1_188.0,
        -691.0 / 360_360.0,
        1.0 / 156.0,
    ];
    let inverse = 1.0 / x;
    inverse * polynomial(&TERMS, inverse * inverse)
}

/// Σ terms\[k\] xᵏ by Horner's rule.
fn polynomial(terms: &[f64], x: f64) -> f64 {
    terms.iter().rev().fold(0.0, |sum, term| sum * x + term)
}

#[cfg(test)]
#[path = "math_tests.rs"]
mod tests;
