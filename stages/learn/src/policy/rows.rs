//! Drawing samples: the distribution's parameters as plain numbers, and the stage's own streams.

use dril_stage_api::StreamRng;
use rand_distr::{Distribution, StandardNormal};
use tch::{Kind, Tensor};

use super::{PolicyFamily, beta::EDGE};
use crate::fast::memory;

/// The parameters of a batch of distributions, row by row.
#[derive(Clone, Debug, PartialEq)]
pub struct Rows {
    family: PolicyFamily,
    actions: usize,
    /// Means, or α.
    first: Vec<f32>,
    /// Standard deviations, or β.
    second: Vec<f32>,
}

impl Rows {
    pub(super) fn gaussian(mean: &Tensor, log_std: &Tensor) -> Self {
        Self::new(PolicyFamily::Gaussian, mean, &log_std.exp().expand_as(mean))
    }

    pub(super) fn beta(alpha: &Tensor, beta: &Tensor) -> Self {
        Self::new(PolicyFamily::Beta, alpha, beta)
    }

    fn new(family: PolicyFamily, first: &Tensor, second: &Tensor) -> Self {
        let plain =
            |tensor: &Tensor| memory::values(&tensor.detach().to_kind(Kind::Float).contiguous()).to_vec();
        Self { family, actions: first.size()[1] as usize, first: plain(first), second: plain(second) }
    }

    /// Draws one sample for each dimension of a row into `sample`.
    pub fn sample(&self, row: usize, stream: &mut StreamRng, sample: &mut [f32]) {
        let at = row * self.actions;
        for (index, sample) in (at..at + self.actions).zip(sample) {
            let (first, second) = (f64::from(self.first[index]), f64::from(self.second[index]));
            *sample = match self.family {
                PolicyFamily::Gaussian => {
                    let normal: f64 = StandardNormal.sample(stream);
                    (first + second * normal) as f32
                }
                PolicyFamily::Beta => draw_beta(first, second, stream),
            };
        }
    }

    /// The mean of each dimension of a row, in the sample's scale, into `sample`.
    pub fn mean(&self, row: usize, sample: &mut [f32]) {
        let at = row * self.actions;
        for (index, sample) in (at..at + self.actions).zip(sample) {
            let (first, second) = (self.first[index], self.second[index]);
            *sample = match self.family {
                PolicyFamily::Gaussian => first,
                PolicyFamily::Beta => (first / (first + second)).clamp(EDGE, 1.0 - EDGE),
            };
        }
    }
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
