//! The draws against their distributions, and bit by bit.

use super::*;
use crate::{Seed, StreamRng, math};

const DRAWS: usize = 20_000;

fn stream() -> StreamRng {
    Seed(7).stream("draw")
}

fn sorted(mut draw: impl FnMut(&mut StreamRng) -> f64) -> Vec<f64> {
    let mut stream = stream();
    let mut drawn: Vec<f64> = (0..DRAWS).map(|_| draw(&mut stream)).collect();
    drawn.sort_by(f64::total_cmp);
    drawn
}

/// The Kolmogorov-Smirnov statistic times √n: above 1.95 in one of a thousand samples of the right distribution.
fn distance(sorted: &[f64], cumulative: impl Fn(f64) -> f64) -> f64 {
    let n = sorted.len() as f64;
    let gaps = sorted.iter().enumerate().map(|(at, &x)| {
        let wanted = cumulative(x);
        (wanted - at as f64 / n).abs().max((wanted - (at + 1) as f64 / n).abs())
    });
    gaps.fold(0.0, f64::max) * n.sqrt()
}

/// The cumulative distribution by the trapezium rule on a grid over [from, to], linear in between.
fn cumulative(log_density: impl Fn(f64) -> f64, from: f64, to: f64) -> impl Fn(f64) -> f64 {
    let cells = 20_000;
    let width = (to - from) / f64::from(cells);
    let density = |at: i32| {
        let x = from + f64::from(at) * width;
        let value = math::exp(log_density(x));
        if value.is_finite() { value } else { 0.0 }
    };
    let mut sums = vec![0.0];
    for cell in 0..cells {
        sums.push(sums[cell as usize] + 0.5 * width * (density(cell) + density(cell + 1)));
    }
    assert!((sums[cells as usize] - 1.0).abs() < 1e-4, "the density's integral is {}", sums[cells as usize]);
    move |x: f64| {
        let at = ((x - from) / width).clamp(0.0, f64::from(cells) - 1.0);
        let cell = at as usize;
        sums[cell] + (at - cell as f64) * (sums[cell + 1] - sums[cell])
    }
}

fn moments(drawn: &[f64]) -> (f64, f64) {
    let n = drawn.len() as f64;
    let mean = drawn.iter().sum::<f64>() / n;
    (mean, drawn.iter().map(|x| (x - mean) * (x - mean)).sum::<f64>() / n)
}

#[test]
fn normal_numbers_are_normally_distributed() {
    let drawn = sorted(normal);
    let (mean, variance) = moments(&drawn);
    assert!(mean.abs() < 0.03 && (variance - 1.0).abs() < 0.05, "{mean} {variance}");
    let log_density = |x: f64| -0.5 * x * x - 0.5 * math::ln(2.0 * std::f64::consts::PI);
    let apart = distance(&drawn, cumulative(log_density, -8.0, 8.0));
    assert!(apart < 1.95, "{apart}");
}

#[test]
fn gamma_numbers_follow_their_distribution() {
    for shape in [1.0, 1.3, 4.0, 60.0] {
        let drawn = sorted(|stream| gamma(stream, shape));
        let (mean, variance) = moments(&drawn);
        let error = 5.0 * (shape / DRAWS as f64).sqrt();
        assert!((mean - shape).abs() < error && (variance / shape - 1.0).abs() < 0.1, "{mean} {variance}");
        let log_density = |x: f64| (shape - 1.0) * math::ln(x.max(1e-300)) - x - math::ln_gamma(shape);
        let apart = distance(&drawn, cumulative(log_density, 0.0, shape + 20.0 * shape.sqrt() + 10.0));
        assert!(apart < 1.95, "{shape}: {apart}");
    }
}

#[test]
fn beta_numbers_follow_their_distribution() {
    for (a, b) in [(1.0, 1.0), (1.69, 1.69), (2.0, 5.0), (80.0, 3.0)] {
        let drawn = sorted(|stream| beta(stream, a, b));
        let log_density = |x: f64| {
            let x = x.clamp(1e-12, 1.0 - 1e-12);
            (a - 1.0) * math::ln(x) + (b - 1.0) * math::ln_1p(-x) - math::ln_beta(a, b)
        };
        let apart = distance(&drawn, cumulative(log_density, 0.0, 1.0));
        assert!(apart < 1.95, "{a} {b}: {apart}");
    }
}

#[test]
fn a_sharp_beta_has_its_mean_and_deviation() {
    let (a, b) = (4e6, 1e6);
    let (mean, variance) = moments(&sorted(|stream| beta(stream, a, b)));
    let wanted = a * b / ((a + b) * (a + b) * (a + b + 1.0));
    assert!((mean - 0.8).abs() < 5.0 * (wanted / DRAWS as f64).sqrt(), "{mean}");
    assert!((variance / wanted - 1.0).abs() < 0.05, "{variance} {wanted}");
}

#[test]
fn choices_come_as_often_as_their_probabilities_say() {
    let (mut stream, mut counts) = (stream(), [0_i32; 3]);
    for _ in 0..DRAWS {
        counts[categorical(&mut stream, [0.2, 0.6, 0.2])] += 1;
    }
    for (count, wanted) in counts.into_iter().zip([4_000, 12_000, 4_000]) {
        assert!((count - wanted).abs() < 300, "{counts:?}");
    }
}

#[test]
fn draws_without_a_distribution_end_all_the_same() {
    let mut stream = stream();
    assert!(gamma(&mut stream, f64::NAN).is_nan() && gamma(&mut stream, 0.99).is_nan());
    assert!(beta(&mut stream, f64::NAN, 2.0).is_nan());
    assert!(!gamma(&mut stream, f64::INFINITY).is_finite());
    assert_eq!(categorical(&mut stream, [f64::NAN, f64::NAN]), 1);
    assert_eq!(categorical(&mut stream, []), 0);
}

#[test]
fn draws_are_the_same_for_ever() {
    // A change here changes every result that anybody has cached: raise every REVISION if it is meant.
    let mut stream = stream();
    let found: Vec<u64> = (0..4)
        .flat_map(|_| {
            let numbers = [normal(&mut stream), gamma(&mut stream, 2.5), beta(&mut stream, 1.5, 300.0)];
            let choice = categorical(&mut stream, [0.1; 10]) as u64;
            numbers.map(f64::to_bits).into_iter().chain([choice])
        })
        .collect();
    assert_eq!(found, GOLDEN);
}

const GOLDEN: [u64; 16] = [
    0x3fc1_e878_93c5_0230,
    0x3fb1_29db_358d_0f9e,
    0x3f6e_3886_a50e_90c9,
    2,
    0x3feb_85a6_da7d_a70b,
    0x3fee_3dfc_8e39_4a0a,
    0x3f5a_9923_d3b3_365b,
    2,
    0xbfdb_b2b7_4c6a_afaa,
    0x400e_38c6_5e77_5ee7,
    0x3f6b_8234_a169_b3b3,
    8,
    0x4005_090b_4805_3cf5,
    0x4010_7cf0_9eee_3121,
    0x3f86_4d4a_1dfa_9867,
    9,
];
