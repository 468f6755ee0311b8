//! Normalisation of observations and rewards by running statistics.
//!
//! Both follow Stable-Baselines3's `VecNormalize`, which the annex's LunarLander experts were trained with; DRIL scales its
//! rewards in the same way, without clipping.

use dril_envs::Frame;
use serde::{Deserialize, Serialize};

/// The weight of the prior (mean 0, variance 1), in observations.
const PRIOR: f64 = 1e-4;
/// Keeps divisors above 0.
const EPSILON: f64 = 1e-8;
/// Clipping range of normalised observations and (optionally) rewards, on both sides of 0.
pub const LIMIT: f64 = 10.0;

/// Merges `count` more values with this mean and population variance into running ones: (mean, variance, weight), after
/// Chan, Golub and LeVeque (1979).
fn merge(into: (&mut f64, &mut f64, f64), (mean, variance, count): (f64, f64, f64)) {
    let (running_mean, running_variance, weight) = into;
    let total = weight + count;
    let delta = mean - *running_mean;
    let squares = *running_variance * weight + variance * count + delta * delta * weight * count / total;
    *running_mean += delta * count / total;
    *running_variance = squares / total;
}

/// Mean and population variance.
fn moments(values: impl ExactSizeIterator<Item = f64> + Clone) -> (f64, f64) {
    let count = values.len() as f64;
    let mean = values.clone().sum::<f64>() / count;
    (mean, values.map(|value| (value - mean).powi(2)).sum::<f64>() / count)
}

/// Mean and variance of each number of an observation vector, over all observations so far.
///
/// Updated during training, and fixed afterwards: a policy that was trained with them needs them to act, so they are
/// stored in its file.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct ObservationStatistics {
    mean: Vec<f64>,
    variance: Vec<f64>,
    /// Number of observations so far, plus the weight of the prior.
    weight: f64,
}

impl ObservationStatistics {
    /// Before the first observation of `len` numbers: mean 0, variance 1.
    pub fn new(len: usize) -> Self {
        Self { mean: vec![0.0; len], variance: vec![1.0; len], weight: PRIOR }
    }

    /// Length of an observation.
    pub fn len(&self) -> usize {
        self.mean.len()
    }

    /// True for observations without numbers.
    pub fn is_empty(&self) -> bool {
        self.mean.is_empty()
    }

    /// True if all numbers are finite and no variance is negative, as required of a file.
    pub fn is_sound(&self) -> bool {
        let finite = |values: &[f64]| values.iter().all(|value| value.is_finite());
        self.mean.len() == self.variance.len()
            && finite(&self.mean)
            && finite(&self.variance)
            && self.variance.iter().all(|variance| *variance >= 0.0)
            && self.weight > 0.0
    }

    /// Adds one observation of each environment; images are ignored.
    pub fn observe<'a>(&mut self, frames: impl Iterator<Item = Frame<'a>>) {
        let vectors: Vec<&[f32]> = frames
            .filter_map(|frame| match frame {
                Frame::Vector(vector) => Some(vector),
                Frame::Image(_) => None,
            })
            .collect();
        if vectors.is_empty() {
            return;
        }
        let count = vectors.len() as f64;
        for (at, (mean, variance)) in self.mean.iter_mut().zip(&mut self.variance).enumerate() {
            let (seen_mean, seen_variance) = moments(vectors.iter().map(|vector| f64::from(vector[at])));
            merge((mean, variance, self.weight), (seen_mean, seen_variance, count));
        }
        self.weight += count;
    }

    /// The vector, normalised by running mean and standard deviation, and clipped to ±[`LIMIT`].
    pub fn scale(&self, vector: &[f32]) -> Vec<f32> {
        let parts = vector.iter().zip(&self.mean).zip(&self.variance);
        parts
            .map(|((value, mean), variance)| {
                ((f64::from(*value) - mean) / (variance + EPSILON).sqrt()).clamp(-LIMIT, LIMIT) as f32
            })
            .collect()
    }
}

/// Scales rewards by the running standard deviation of the discounted return (Engstrom et al. 2020, "Implementation
/// Matters in Deep Policy Gradients"). No mean is subtracted, and the state is kept over all updates.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct RewardNormalizer {
    gamma: f64,
    /// The discounted return so far, one per environment; 0 at the start of an episode.
    sums: Vec<f64>,
    mean: f64,
    variance: f64,
    count: f64,
    /// Clipping range of scaled rewards, on both sides of 0.
    limit: Option<f64>,
    /// True until the first rewards, if the returns start with these.
    from_first: bool,
}

impl RewardNormalizer {
    /// For `envs` environments, with discount `gamma`, as in DRIL's reference code: no clipping, and the returns start with
    /// the first rewards, so that the very first step counts (1 + γ) times.
    pub fn new(envs: usize, gamma: f64) -> Self {
        let sums = vec![0.0; envs];
        Self { gamma, sums, mean: 0.0, variance: 1.0, count: PRIOR, limit: None, from_first: true }
    }

    /// As in Stable-Baselines3's `VecNormalize`: scaled rewards are clipped to ±[`LIMIT`], and the returns start at 0.
    pub fn clipped(envs: usize, gamma: f64) -> Self {
        Self { limit: Some(LIMIT), from_first: false, ..Self::new(envs, gamma) }
    }

    /// Scales `rewards` (`[step][environment]`) in place, each by the variance up to its own step. `dones` (same layout) is
    /// true for the last step of an episode.
    pub fn normalize(&mut self, rewards: &mut [f32], dones: &[bool]) {
        let envs = self.sums.len();
        if std::mem::take(&mut self.from_first) {
            self.sums.iter_mut().zip(&*rewards).for_each(|(sum, reward)| *sum = f64::from(*reward));
        }
        for (rewards, dones) in rewards.chunks_exact_mut(envs).zip(dones.chunks_exact(envs)) {
            for (sum, reward) in self.sums.iter_mut().zip(&*rewards) {
                *sum = *sum * self.gamma + f64::from(*reward);
            }
            self.observe_sums();
            self.sums.iter_mut().zip(dones).filter(|(_, done)| **done).for_each(|(sum, _)| *sum = 0.0);
            let scale = (self.variance + EPSILON).sqrt();
            let limit = self.limit.unwrap_or(f64::INFINITY);
            for reward in rewards {
                *reward = (f64::from(*reward) / scale).clamp(-limit, limit) as f32;
            }
        }
    }

    /// Adds the returns of one step to the running statistics.
    fn observe_sums(&mut self) {
        let count = self.sums.len() as f64;
        let (mean, variance) = moments(self.sums.iter().copied());
        merge((&mut self.mean, &mut self.variance, self.count), (mean, variance, count));
        self.count += count;
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    /// Mean and population variance of a list with the first guess in it, by the book.
    fn by_the_book(seen: &[f64]) -> (f64, f64) {
        let total = PRIOR + seen.len() as f64;
        let mean = seen.iter().sum::<f64>() / total;
        let squares =
            PRIOR * (1.0 + mean * mean) + seen.iter().map(|value| (value - mean).powi(2)).sum::<f64>();
        (mean, squares / total)
    }

    #[test]
    fn rewards_are_divided_by_the_deviation_of_their_discounted_sum() {
        let mut normalizer = RewardNormalizer::new(1, 0.5);
        let mut rewards = [1.0, -1.0, 1.0];
        normalizer.normalize(&mut rewards, &[false, true, false]);
        // Sums: 1·0.5 + 1 = 1.5 (they begin with the first reward), 1.5·0.5 - 1 = -0.25, and 1 since an episode starts.
        let (_, variance) = by_the_book(&[1.5, -0.25, 1.0]);
        assert!((f64::from(rewards[2]) - 1.0 / (variance + 1e-8).sqrt()).abs() < 1e-6);
        assert!(rewards[1] < 0.0, "no mean is subtracted, so signs stay");
    }

    #[test]
    fn two_rollouts_in_a_row_are_one_long_one() {
        let rewards: Vec<f32> = (0..40).map(|at| if at % 7 == 0 { -1.0 } else { 1.0 }).collect();
        let ends: Vec<bool> = (0..40).map(|at| at % 11 == 0).collect();
        let mut whole = rewards.clone();
        RewardNormalizer::new(4, 0.99).normalize(&mut whole, &ends);
        let mut halves = rewards;
        let mut normalizer = RewardNormalizer::new(4, 0.99);
        for (rewards, ends) in halves.chunks_mut(20).zip(ends.chunks(20)) {
            normalizer.normalize(rewards, ends);
        }
        assert_eq!(whole, halves);
    }

    #[test]
    fn clipped_rewards_stay_within_ten_deviations() {
        let mut normalizer = RewardNormalizer::clipped(1, 0.0);
        let mut rewards = [0.001, -0.001, 0.0005, 500.0];
        let mut plain = rewards;
        normalizer.normalize(&mut rewards[..3], &[false; 3]);
        // The sum of squares that the last one brings is not in the divisor of the others.
        let before = normalizer.clone();
        normalizer.normalize(&mut rewards[3..], &[false]);
        assert!(rewards[3] <= 10.0 && rewards[3] > 1.0, "{rewards:?}");
        RewardNormalizer { limit: None, ..before }.normalize(&mut plain[3..], &[false]);
        assert_eq!(f64::from(plain[3]).clamp(-10.0, 10.0) as f32, rewards[3]);
    }

    #[test]
    fn observations_are_shown_in_deviations_from_the_mean_and_clipped() {
        let mut statistics = ObservationStatistics::new(2);
        let seen = [[1.0_f32, 5.0], [3.0, 5.0], [5.0, 5.0], [7.0, 5.0]];
        statistics.observe(seen[..1].iter().map(|vector| Frame::Vector(vector)));
        statistics.observe(seen[1..].iter().map(|vector| Frame::Vector(vector)));
        let shown = statistics.scale(&[4.0 + 5.0_f32.sqrt(), 5.0]);
        assert!((shown[0] - 1.0).abs() < 1e-3, "{shown:?}");
        assert_eq!(statistics.scale(&[1e6, -1e6]), [10.0, -10.0]);
        let text = serde_json::to_string(&statistics).unwrap();
        assert_eq!(serde_json::from_str::<ObservationStatistics>(&text).unwrap(), statistics);
        assert!(statistics.is_sound());
    }

    proptest! {
        #[test]
        fn the_running_moments_are_those_of_everything_seen(
            steps in proptest::collection::vec(proptest::array::uniform3(-1f32..1.0), 1..50),
        ) {
            // With a discount of 0 the sums are the rewards themselves.
            let mut normalizer = RewardNormalizer::new(3, 0.0);
            let seen: Vec<f64> = steps.concat().into_iter().map(f64::from).collect();
            normalizer.normalize(&mut steps.concat(), &vec![false; seen.len()]);
            let (mean, variance) = by_the_book(&seen);
            prop_assert!((normalizer.mean - mean).abs() < 1e-9);
            prop_assert!((normalizer.variance - variance).abs() < 1e-9);
        }
    }
}
