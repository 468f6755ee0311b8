//! Rows against closed forms, values of high precision and differences, and bit by bit.

use dril_kinds::PolicyFamily;
use dril_stage_api::{Seed, StreamRng};
use proptest::prelude::*;
use rand::RngExt;

use super::*;
use crate::policy::beta::EDGE;

#[path = "distribution_oracle_tests.rs"]
mod oracle_tests;

const FAMILIES: [PolicyFamily; 3] = [PolicyFamily::Gaussian, PolicyFamily::Beta, PolicyFamily::Categorical];

/// The outputs of a head for a batch of observations, row-major.
#[derive(Clone, Copy, Debug, PartialEq)]
struct RowBatch<'a> {
    /// The family.
    family: PolicyFamily,
    /// Numbers in a row of an output: dimensions, or choices.
    width: usize,
    /// The first output, [batch · width]: means, u or logits.
    first: &'a [f32],
    /// The second, [batch · width]: w; empty where there is none.
    second: &'a [f32],
    /// The parameter that all rows share, [width]: `log_std`; empty where there is none.
    shared: &'a [f32],
}

impl<'a> RowBatch<'a> {
    /// How many rows there are.
    fn len(&self) -> usize {
        self.first.len() / self.width.max(1)
    }

    /// One of them.
    fn row(&self, index: usize) -> Row<'a> {
        let part = |output: &'a [f32]| &output[index * self.width..][..self.width];
        match self.family {
            PolicyFamily::Gaussian => Row::Gaussian { mean: part(self.first), log_std: self.shared },
            PolicyFamily::Beta => Row::Beta { u: part(self.first), w: part(self.second) },
            PolicyFamily::Categorical => Row::Categorical { logits: part(self.first) },
        }
    }
}

/// What the gradients of a batch are added to, laid out as [`RowBatch`].
#[derive(Debug)]
struct RowBatchGradient<'a> {
    /// Numbers in a row of an output.
    width: usize,
    /// For the first output.
    first: &'a mut [f32],
    /// For the second; empty where there is none.
    second: &'a mut [f32],
    /// For the parameter that all rows share; empty where there is none.
    shared: &'a mut [f64],
}

impl RowBatchGradient<'_> {
    /// The part of one row.
    fn row(&mut self, index: usize) -> RowGradient<'_> {
        let at = index * self.width;
        let second = if self.second.is_empty() { 0..0 } else { at..at + self.width };
        RowGradient {
            first: &mut self.first[at..at + self.width],
            second: &mut self.second[second],
            shared: self.shared,
        }
    }
}

/// A batch of rows with numbers that own them.
#[derive(Clone, Debug)]
struct Case {
    family: PolicyFamily,
    width: usize,
    first: Vec<f32>,
    second: Vec<f32>,
    shared: Vec<f32>,
    samples: Vec<f32>,
}

/// The gradients of a case, in the same form.
#[derive(Debug)]
struct Found {
    first: Vec<f32>,
    second: Vec<f32>,
    shared: Vec<f64>,
}

impl Case {
    /// Raw outputs within ±`spread`, with samples drawn from them.
    fn random(family: PolicyFamily, rows: usize, width: usize, spread: f32, seed: u64) -> Self {
        let mut stream = Seed(seed).stream("case");
        let mut numbers = |count: usize, spread: f32| -> Vec<f32> {
            (0..count).map(|_| spread * (2.0 * stream.random::<f32>() - 1.0)).collect()
        };
        let first = numbers(rows * width, spread);
        let second = if family == PolicyFamily::Beta { numbers(rows * width, spread) } else { Vec::new() };
        let shared = if family == PolicyFamily::Gaussian { numbers(width, 1.5) } else { Vec::new() };
        let mut case = Self { family, width, first, second, shared, samples: Vec::new() };
        let mut samples = vec![0.0; rows * case.sample_len()];
        for (index, sample) in samples.chunks_exact_mut(case.sample_len()).enumerate() {
            case.batch().row(index).sample(&mut stream, sample);
        }
        case.samples = samples;
        case
    }

    fn sample_len(&self) -> usize {
        if self.family == PolicyFamily::Categorical { 1 } else { self.width }
    }

    fn batch(&self) -> RowBatch<'_> {
        let Self { family, width, first, second, shared, .. } = self;
        RowBatch { family: *family, width: *width, first, second, shared }
    }

    fn sample(&self, row: usize) -> &[f32] {
        &self.samples[row * self.sample_len()..][..self.sample_len()]
    }

    fn log_probs(&self) -> Vec<f64> {
        (0..self.batch().len()).map(|row| self.batch().row(row).log_prob(self.sample(row))).collect()
    }

    fn entropies(&self) -> Vec<f64> {
        (0..self.batch().len()).map(|row| self.batch().row(row).entropy()).collect()
    }

    /// Σ over rows of the weighted log-density and entropy.
    fn objective(&self, weights: &[Weights]) -> f64 {
        let rows = self.log_probs().into_iter().zip(self.entropies()).zip(weights);
        rows.map(|((log_prob, entropy), weights)| weights.log_prob * log_prob + weights.entropy * entropy)
            .sum()
    }

    fn cloning_loss(&self, demonstrated: &[f32]) -> f64 {
        let rows = demonstrated.chunks_exact(self.sample_len()).enumerate();
        rows.map(|(row, demonstrated)| self.batch().row(row).cloning_loss(demonstrated)).sum()
    }

    fn gradient(&self, mut add: impl FnMut(usize, Row<'_>, RowGradient<'_>)) -> Found {
        let mut found = Found {
            first: vec![0.0; self.first.len()],
            second: vec![0.0; self.second.len()],
            shared: vec![0.0; self.shared.len()],
        };
        let Found { first, second, shared } = &mut found;
        let mut into = RowBatchGradient { width: self.width, first, second, shared };
        for row in 0..self.batch().len() {
            add(row, self.batch().row(row), into.row(row));
        }
        found
    }

    fn gradient_of_objective(&self, weights: &[Weights]) -> Found {
        self.gradient(|row, distribution, into| {
            distribution.add_gradient(self.sample(row), weights[row], into);
        })
    }

    fn gradient_of_cloning(&self, demonstrated: &[f32]) -> Found {
        let len = self.sample_len();
        self.gradient(|row, distribution, into| {
            distribution.add_cloning_gradient(&demonstrated[row * len..][..len], 1.0, into);
        })
    }
}

impl Found {
    fn all(&self) -> Vec<f64> {
        let raw = self.first.iter().chain(&self.second).map(|&value| f64::from(value));
        raw.chain(self.shared.iter().copied()).collect()
    }
}

fn random_weights(rows: usize, stream: &mut StreamRng) -> Vec<Weights> {
    let mut number = || 2.0 * stream.random::<f64>() - 1.0;
    (0..rows).map(|_| Weights { log_prob: number(), entropy: number() }).collect()
}

#[test]
fn log_probability_and_entropy_equal_their_closed_forms() {
    let near = |found: f64, wanted: f64| assert!((found - wanted).abs() < 1e-7, "{found}, expected {wanted}");
    let gaussian = Row::Gaussian { mean: &[0.5, -1.0], log_std: &[0.0, -0.5] };
    let (tau, s) = (2.0 * std::f64::consts::PI, (-0.5_f64).exp());
    let density = |x: f64, m: f64, s: f64| (-(x - m).powi(2) / (2.0 * s * s)).exp() / (s * tau.sqrt());
    near(gaussian.log_prob(&[0.0, -1.5]), density(0.0, 0.5, 1.0).ln() + density(-1.5, -1.0, s).ln());
    near(gaussian.entropy(), (tau * std::f64::consts::E).ln() - 0.5);
    // softplus(u) = 1 and softplus(w) = 2 give Beta(2, 3), whose density is 12 x (1 − x)² and whose entropy 9/4 − ln 12.
    let (u, w) = ([(1.0_f64.exp() - 1.0).ln() as f32], [(2.0_f64.exp() - 1.0).ln() as f32]);
    let beta = Row::Beta { u: &u, w: &w };
    near(beta.log_prob(&[0.25]), (12.0_f64 * 0.25 * 0.75 * 0.75).ln());
    near(beta.entropy(), 2.25 - 12.0_f64.ln());
    let logits = [2.0_f32.ln(), 0.0, 0.0];
    let categorical = Row::Categorical { logits: &logits };
    near(categorical.log_prob(&[0.0]), 0.5_f64.ln());
    near(categorical.log_prob(&[2.0]), 0.25_f64.ln());
    near(categorical.entropy(), 1.5 * 2.0_f64.ln());
    near(categorical.cloning_loss(&[1.0]), 4.0_f64.ln());
}

#[test]
fn the_betas_log_probability_is_accurate_at_high_concentrations() {
    // u, w, x, log-density and entropy by mpmath with 50 digits, at the floats nearest to u, w and x:
    // a, b = log1p(exp(u)) + 1, log1p(exp(w)) + 1; ln B by three loggamma.
    for (u, w, x, log_prob, entropy) in [
        (0.3, -1.2, 0.62, 0.296_938_942_461_280_6, -0.099_328_078_431_546_47),
        (-30.0, -30.0, 0.4, 5.360_829_195_413_891e-14, -3.109_138_665_109_667e-27),
        (12.5, 80.0, 0.131, 2.415_057_408_415_323_3, -1.925_835_503_611_136_3),
        (1e5, 1e5, 0.5012, 5.301_227_560_211_688_5, -5.377_252_470_082_859),
        (1e5, 4e5, 0.2011, 4.673_063_161_535_433, -6.058_536_137_365_647),
        (1e7, 1e7, 0.50003, 8.143_875_359_143_381, -7.679_830_138_114_402),
    ] {
        let row = Row::Beta { u: &[u], w: &[w] };
        // What remains is the rounding of terms as large as the concentration.
        let error = 1e-15 * f64::from(u.max(w)).max(1.0);
        let found = row.log_prob(&[x]);
        assert!((found - log_prob).abs() < 10.0 * error, "{u} {w}: {found}, expected {log_prob}");
        let found = row.entropy();
        assert!((found - entropy).abs() < 50.0 * error, "{u} {w}: {found}, expected {entropy}");
    }
}

#[test]
fn means_and_draws_lie_in_the_samples_scale_and_off_the_ends() {
    let mut sample = [0.0; 2];
    Row::Gaussian { mean: &[3.0, -0.5], log_std: &[0.0, 0.0] }.mean(&mut sample);
    assert_eq!(sample, [3.0, -0.5]);
    let sharp = Row::Beta { u: &[1e7, 0.0], w: &[-40.0, 0.0] };
    sharp.mean(&mut sample);
    assert_eq!(sample, [1.0 - EDGE, 0.5]);
    let mut stream = Seed(5).stream("action");
    for _ in 0..1_000 {
        sharp.sample(&mut stream, &mut sample);
        assert!(sample.iter().all(|&x| (EDGE..=1.0 - EDGE).contains(&x)), "{sample:?}");
        assert!(sharp.log_prob(&sample).is_finite());
    }
    let mut choice = [0.0];
    Row::Categorical { logits: &[0.0, 2.0, 2.0] }.mean(&mut choice);
    assert_eq!(choice, [1.0], "the first of the likeliest");
}

#[test]
fn outputs_that_are_not_numbers_give_a_loss_that_is_none_and_end() {
    let mut stream = Seed(5).stream("action");
    let nan = [f32::NAN];
    let (beta, choices) = (Row::Beta { u: &nan, w: &[0.0] }, [f32::NAN, 0.0]);
    let categorical = Row::Categorical { logits: &choices };
    let gaussian = Row::Gaussian { mean: &nan, log_std: &[0.0] };
    for row in [gaussian, beta, categorical] {
        let mut sample = [0.5];
        row.sample(&mut stream, &mut sample);
        assert!(row.log_prob(&sample).is_nan(), "{row:?}");
    }
}

#[test]
fn samples_have_the_moments_of_their_distribution() {
    let moments = |row: Row<'_>| {
        let (mut stream, mut sample, n) = (Seed(5).stream("action"), [0.0], 40_000);
        let (mut sum, mut squares) = (0.0, 0.0);
        for _ in 0..n {
            row.sample(&mut stream, &mut sample);
            sum += f64::from(sample[0]);
            squares += f64::from(sample[0]) * f64::from(sample[0]);
        }
        let mean = sum / f64::from(n);
        (mean, (squares / f64::from(n) - mean * mean).sqrt())
    };
    let (mean, std) = moments(Row::Gaussian { mean: &[0.5], log_std: &[2.0_f32.ln()] });
    assert!((mean - 0.5).abs() < 0.05 && (std - 2.0).abs() < 0.05, "{mean} {std}");
    // softplus(u) = 1, softplus(w) = 4: Beta(2, 5).
    let (u, w) = ([(1.0_f64.exp() - 1.0).ln() as f32], [(4.0_f64.exp() - 1.0).ln() as f32]);
    let (mean, std) = moments(Row::Beta { u: &u, w: &w });
    let wanted = (10.0_f64 / (49.0 * 8.0)).sqrt();
    assert!((mean - 2.0 / 7.0).abs() < 0.005 && (std - wanted).abs() < 0.005, "{mean} {std}");
    // Probabilities 1/4 and 3/4.
    let (mean, _) = moments(Row::Categorical { logits: &[0.0, 3.0_f32.ln()] });
    assert!((mean - 0.75).abs() < 0.01, "{mean}");
}

/// The objective's differences over ±h in every raw output and shared parameter.
fn differences(case: &Case, objective: impl Fn(&Case) -> f64) -> Vec<f64> {
    let counts = [case.first.len(), case.second.len(), case.shared.len()];
    let mut all = Vec::new();
    for (part, count) in counts.into_iter().enumerate() {
        for index in 0..count {
            let moved = |by: f32| {
                let mut moved = case.clone();
                let values = [&mut moved.first, &mut moved.second, &mut moved.shared].into_iter().nth(part);
                let value = &mut values.unwrap()[index];
                *value += by;
                (f64::from(*value), objective(&moved))
            };
            let ((low, below), (high, above)) = (moved(-1e-3), moved(1e-3));
            all.push((above - below) / (high - low));
        }
    }
    all
}

fn family() -> impl Strategy<Value = PolicyFamily> {
    prop::sample::select(FAMILIES.to_vec())
}

proptest! {
    #[test]
    fn gradients_are_the_slopes_of_the_objective(family in family(), seed in 0_u64..1_000, spread in 0.1_f32..6.0) {
        let case = Case::random(family, 2, 3, spread, seed);
        let weights = random_weights(2, &mut Seed(seed).stream("weights"));
        let found = case.gradient_of_objective(&weights).all();
        for (found, wanted) in found.iter().zip(differences(&case, |case| case.objective(&weights))) {
            prop_assert!((found - wanted).abs() < 1e-4 * (1.0 + wanted.abs()), "{found} {wanted}");
        }
    }

    #[test]
    fn gradients_of_cloning_are_the_slopes_of_its_loss(family in family(), seed in 0_u64..1_000) {
        let mut case = Case::random(family, 2, 3, 0.9, seed);
        // A saturated prediction, far from the corner at 1.
        case.first[0] = 1.5;
        let demonstrated = match family {
            PolicyFamily::Categorical => vec![2.0, 0.0],
            PolicyFamily::Gaussian | PolicyFamily::Beta => vec![0.3, -2.0, 0.9, 1.0, 0.0, -0.4],
        };
        let found = case.gradient_of_cloning(&demonstrated).all();
        for (found, wanted) in found.iter().zip(differences(&case, |case| case.cloning_loss(&demonstrated))) {
            prop_assert!((found - wanted).abs() < 1e-4 * (1.0 + wanted.abs()), "{found} {wanted}");
        }
        if family == PolicyFamily::Gaussian {
            prop_assert_eq!(found[0], 0.0);
        }
    }
}

#[test]
fn gradients_are_added_and_every_bit_is_the_same_on_every_machine() {
    let mut hasher = blake3::Hasher::new();
    for family in FAMILIES {
        let case = Case::random(family, 50, 3, 8.0, 4);
        let weights = random_weights(50, &mut Seed(4).stream("weights"));
        let once = case.gradient_of_objective(&weights);
        let twice = case.gradient(|row, distribution, mut into| {
            for _ in 0..2 {
                let RowGradient { first, second, shared } = &mut into;
                let into = RowGradient { first, second, shared };
                distribution.add_gradient(case.sample(row), weights[row], into);
            }
        });
        assert!(once.first.iter().zip(&twice.first).all(|(once, twice)| 2.0 * once == *twice));
        let samples = case.samples.iter().map(|&x| f64::from(x)).collect();
        for value in [samples, case.log_probs(), case.entropies(), once.all()].concat() {
            hasher.update(&value.to_le_bytes());
        }
    }
    assert_eq!(&hasher.finalize().to_hex()[..16], "b2e6cdbfbe61c23c");
}
