//! Drawing samples: the distribution's parameters as plain numbers, and the stage's own streams.

use dril_stage_api::StreamRng;
use rand::RngExt;
use rand_distr::{Distribution, StandardNormal};
use tch::{Kind, Tensor};

use super::{PolicyFamily, beta::EDGE};
use crate::fast::memory;

/// The parameters of a batch of distributions, row by row.
#[derive(Clone, Debug, PartialEq)]
pub struct Rows {
    family: PolicyFamily,
    actions: usize,
    /// Means, or α, or the probabilities of all choices.
    first: Vec<f32>,
    /// Standard deviations, or β; empty for choices.
    second: Vec<f32>,
}

impl Rows {
    pub(super) fn gaussian(mean: &Tensor, log_std: &Tensor) -> Self {
        Self::new(PolicyFamily::Gaussian, mean, &log_std.exp().expand_as(mean))
    }

    pub(super) fn beta(alpha: &Tensor, beta: &Tensor) -> Self {
        Self::new(PolicyFamily::Beta, alpha, beta)
    }

    pub(super) fn categorical(logits: &Tensor) -> Self {
        let probabilities = logits.softmax(-1, Kind::Float);
        let (choices, first) = (logits.size()[1] as usize, plain(&probabilities));
        Self { family: PolicyFamily::Categorical, actions: choices, first, second: Vec::new() }
    }

    fn new(family: PolicyFamily, first: &Tensor, second: &Tensor) -> Self {
        Self { family, actions: first.size()[1] as usize, first: plain(first), second: plain(second) }
    }

    /// Draws one sample for each dimension of a row into `sample`.
    pub fn sample(&self, row: usize, stream: &mut StreamRng, sample: &mut [f32]) {
        let at = row * self.actions;
        if self.family == PolicyFamily::Categorical {
            sample[0] = draw_choice(&self.first[at..at + self.actions], stream);
            return;
        }
        for (index, sample) in (at..at + self.actions).zip(sample) {
            let (first, second) = (f64::from(self.first[index]), f64::from(self.second[index]));
            *sample = match self.family {
                PolicyFamily::Gaussian | PolicyFamily::Categorical => {
                    let normal: f64 = StandardNormal.sample(stream);
                    (first + second * normal) as f32
                }
                PolicyFamily::Beta => draw_beta(first, second, stream),
            };
        }
    }

    /// The mean of each dimension of a row, in the sample's scale, into `sample`; of choices the likeliest.
    pub fn mean(&self, row: usize, sample: &mut [f32]) {
        let at = row * self.actions;
        if self.family == PolicyFamily::Categorical {
            sample[0] = likeliest(&self.first[at..at + self.actions]);
            return;
        }
        for (index, sample) in (at..at + self.actions).zip(sample) {
            let (first, second) = (self.first[index], self.second[index]);
            *sample = match self.family {
                PolicyFamily::Gaussian | PolicyFamily::Categorical => first,
                PolicyFamily::Beta => (first / (first + second)).clamp(EDGE, 1.0 - EDGE),
            };
        }
    }
}

fn plain(tensor: &Tensor) -> Vec<f32> {
    memory::values(&tensor.detach().to_kind(Kind::Float).contiguous()).to_vec()
}

/// The choice in whose part of the line from 0 to 1 a uniform number falls. Probabilities that are not numbers give the
/// last one: the update that follows reports them.
fn draw_choice(probabilities: &[f32], stream: &mut StreamRng) -> f32 {
    let drawn: f64 = stream.random();
    let mut sum = 0.0;
    let found = probabilities.iter().position(|probability| {
        sum += f64::from(*probability);
        drawn < sum
    });
    found.unwrap_or(probabilities.len().saturating_sub(1)) as f32
}

/// The first of the highest.
fn likeliest(probabilities: &[f32]) -> f32 {
    let mut best = 0;
    for (choice, probability) in probabilities.iter().enumerate() {
        if *probability > probabilities[best] {
            best = choice;
        }
    }
    best as f32
}

/// A sample within the open interval. Shapes that are not numbers (a network that has diverged) give one too: the
/// update that follows reports it with its cause.
fn draw_beta(alpha: f64, beta: f64, stream: &mut StreamRng) -> f32 {
    let drawn = rand_distr::Beta::new(alpha, beta).map_or(f64::NAN, |beta| beta.sample(stream));
    (drawn as f32).clamp(EDGE, 1.0 - EDGE)
}

#[cfg(test)]
mod tests {
    use super::*;
    use dril_stage_api::Seed;

    fn moments(rows: &Rows) -> (f64, f64) {
        let mut stream = Seed(5).stream("action");
        let mut sample = [0.0];
        let (mut sum, mut squares) = (0.0, 0.0);
        let n = 40_000;
        for _ in 0..n {
            rows.sample(0, &mut stream, &mut sample);
            sum += f64::from(sample[0]);
            squares += f64::from(sample[0]).powi(2);
        }
        let mean = sum / f64::from(n);
        (mean, (squares / f64::from(n) - mean * mean).sqrt())
    }

    #[test]
    fn samples_have_the_moments_of_their_distribution() {
        let rows = Rows { family: PolicyFamily::Gaussian, actions: 1, first: vec![0.5], second: vec![2.0] };
        let (mean, std) = moments(&rows);
        assert!((mean - 0.5).abs() < 0.05 && (std - 2.0).abs() < 0.05, "{mean} {std}");
        let (a, b) = (2.0_f64, 5.0_f64);
        let rows = Rows { family: PolicyFamily::Beta, actions: 1, first: vec![2.0], second: vec![5.0] };
        let (mean, std) = moments(&rows);
        let wanted = (a * b / ((a + b).powi(2) * (a + b + 1.0))).sqrt();
        assert!((mean - a / (a + b)).abs() < 0.005 && (std - wanted).abs() < 0.005, "{mean} {std}");
    }

    #[test]
    fn choices_come_as_often_as_their_probabilities_say() {
        let logits = Tensor::from_slice(&[0.0_f32, 3.0_f32.ln(), 0.0]).view([1, 3]);
        let rows = Rows::categorical(&logits);
        let (mut stream, mut sample, mut counts) = (Seed(5).stream("action"), [0.0], [0; 3]);
        for _ in 0..20_000 {
            rows.sample(0, &mut stream, &mut sample);
            counts[sample[0] as usize] += 1;
        }
        for (count, wanted) in counts.into_iter().zip([4_000, 12_000, 4_000]) {
            assert!(i32::abs(count - wanted) < 300, "{counts:?}");
        }
        rows.mean(0, &mut sample);
        assert_eq!(sample, [1.0]);
    }

    #[test]
    fn a_sharp_beta_never_reaches_the_ends() {
        let rows = Rows { family: PolicyFamily::Beta, actions: 1, first: vec![1e6], second: vec![1.0] };
        let mut sample = [0.0];
        let mut stream = Seed(5).stream("action");
        for _ in 0..1000 {
            rows.sample(0, &mut stream, &mut sample);
            assert!(sample[0] > 0.0 && sample[0] < 1.0);
        }
    }
}
