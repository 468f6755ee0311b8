//! Random draws whose bits are the same on every machine.
//!
//! The methods are exact (rejection or inversion) and use the functions of [`crate::math`]. The crate `rand_distr` uses
//! the C library's logarithm and exponential, whose last bits depend on the processor, so it must not be used for
//! anything that reaches a result.

use rand::{Rng, RngExt};

use crate::math;

/// A sample from the standard normal distribution, by Marsaglia's polar method. The method's second sample is discarded,
/// so that the stream's position is the whole state.
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

/// A sample from the gamma distribution with shape ≥ 1 and scale 1 (Marsaglia and Tsang 2000). NaN for a NaN shape or one
/// below 1.
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
        // The first test is a cheap sufficient condition for the second. An infinite shape makes the bound NaN, which must
        // not loop forever.
        let square = x * x;
        if v > 0.0 {
            let bound = 0.5 * square + d * (1.0 - v + math::ln(v));
            if u < 1.0 - 0.0331 * square * square || math::ln(u) < bound || bound.is_nan() {
                return d * v;
            }
        }
    }
}

/// A sample from the Beta distribution with shape parameters ≥ 1: X / (X + Y) of two gamma samples. NaN for a NaN shape or
/// one below 1. At extreme shapes it can round to 0 or 1.
pub fn beta<R: Rng + ?Sized>(rng: &mut R, alpha: f64, beta: f64) -> f64 {
    let x = gamma(rng, alpha);
    let y = gamma(rng, beta);
    x / (x + y)
}

/// A sample from a categorical distribution, by inversion: the index of the probability in whose interval a uniform number
/// falls. The last index if the probabilities sum to less than 1 or contain NaN; 0 if there are none.
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
