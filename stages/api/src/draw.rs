//! Random draws whose bits are the same on every machine.
//!
//! The methods are exact (rejection or inversion), use the functions of [`crate::math`], and take their uniform numbers
//! from the stream they are given. The crate `rand_distr` goes through the C library's logarithm and exponential, whose
//! last bits depend on the processor, and so must not be used for anything that reaches a result.

use rand::{Rng, RngExt};

use crate::math;

/// A number from the standard normal distribution, by Marsaglia's polar method. Its second number is thrown away, so
/// that a stream's position is all the state there is.
pub fn normal<R: Rng + ?Sized>(rng: &mut R) -> f64 {
    loop {
        let x = 2.0 * rng.random::<f64>() - 1.0;
        let y = 2.0 * rng.random::<f64>() - 1.0;
        let square = x * x + y * y;
        if square < 1.0 && square > 0.0 {
            return x * (-2.0 * math::ln(square) / square).sqrt();
        }
    }
}

/// A number from the gamma distribution with that shape, at least 1, and scale 1 (Marsaglia and Tsang 2000). Not a
/// number where the shape is none or below 1.
pub fn gamma<R: Rng + ?Sized>(rng: &mut R, shape: f64) -> f64 {
    if shape.is_nan() || shape < 1.0 {
        return f64::NAN;
    }
    let d = shape - 1.0 / 3.0;
    let c = 1.0 / (9.0 * d).sqrt();
    loop {
        let x = normal(rng);
        let root = 1.0 + c * x;
        let v = root * root * root;
        let u: f64 = rng.random();
        // The first test is a cheap part of the second. An infinite shape makes the bound not a number: that must not
        // loop for ever.
        let square = x * x;
        if v > 0.0 {
            let bound = 0.5 * square + d * (1.0 - v + math::ln(v));
            if u < 1.0 - 0.0331 * square * square || math::ln(u) < bound || bound.is_nan() {
                return d * v;
            }
        }
    }
}

/// A number from the Beta distribution with shape parameters of at least 1: X / (X + Y) of two gamma numbers. Not a
/// number where a shape is none or below 1. In double precision it can round to 0 or 1 at extreme shapes.
pub fn beta<R: Rng + ?Sized>(rng: &mut R, alpha: f64, beta: f64) -> f64 {
    let x = gamma(rng, alpha);
    let y = gamma(rng, beta);
    x / (x + y)
}

/// The index in whose part of the line from 0 to 1 one uniform number falls; the last one where the probabilities sum
/// to less, are not numbers or are none (0 where there is none at all).
pub fn categorical<R: Rng + ?Sized>(rng: &mut R, probabilities: impl IntoIterator<Item = f64>) -> usize {
    let drawn: f64 = rng.random();
    let (mut sum, mut last) = (0.0, 0);
    for (index, probability) in probabilities.into_iter().enumerate() {
        sum += probability;
        last = index;
        if drawn < sum {
            break;
        }
    }
    last
}

#[cfg(test)]
#[path = "draw_tests.rs"]
mod tests;
