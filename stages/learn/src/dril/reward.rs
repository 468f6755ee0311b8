//! What happens to DRIL's rewards between the ensemble and PPO: they are summed up per episode (the U-signal) and
//! divided by the running standard deviation of their discounted sum.

use serde::{Deserialize, Serialize};

/// Scales rewards by the running standard deviation of their discounted sum (Engstrom et al. 2020, "Implementation
/// Matters in Deep Policy Gradients"): no mean is subtracted, nothing is clipped, and the state lasts over all updates.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct RewardNormalizer {
    gamma: f64,
    /// The discounted sum so far, one an environment; 0 where an episode starts.
    sums: Vec<f64>,
    mean: f64,
    variance: f64,
    count: f64,
}

impl RewardNormalizer {
    /// The weight of the first guess (mean 0, variance 1), in observations.
    const PRIOR: f64 = 1e-4;
    /// Keeps the divisor above 0.
    const EPSILON: f64 = 1e-8;

    /// For `envs` environments, with discount `gamma`.
    pub fn new(envs: usize, gamma: f64) -> Self {
        Self { gamma, sums: vec![0.0; envs], mean: 0.0, variance: 1.0, count: Self::PRIOR }
    }

    /// Scales `rewards` (`[step][environment]`) in place, each by the variance up to its own step. `ends` (same layout)
    /// is true where a step was the last of its episode.
    pub fn normalize(&mut self, rewards: &mut [f32], ends: &[bool]) {
        let envs = self.sums.len();
        for (rewards, ends) in rewards.chunks_exact_mut(envs).zip(ends.chunks_exact(envs)) {
            for (sum, reward) in self.sums.iter_mut().zip(&*rewards) {
                *sum = *sum * self.gamma + f64::from(*reward);
            }
            self.observe_sums();
            self.sums.iter_mut().zip(ends).filter(|(_, end)| **end).for_each(|(sum, _)| *sum = 0.0);
            let scale = (self.variance + Self::EPSILON).sqrt();
            rewards.iter_mut().for_each(|reward| *reward = (f64::from(*reward) / scale) as f32);
        }
    }

    /// Merges the mean and population variance of one step's sums into the running ones (Chan, Golub and LeVeque 1979).
    fn observe_sums(&mut self) {
        let count = self.sums.len() as f64;
        let mean = self.sums.iter().sum::<f64>() / count;
        let variance = self.sums.iter().map(|sum| (sum - mean).powi(2)).sum::<f64>() / count;
        let total = self.count + count;
        let delta = mean - self.mean;
        let squares =
            self.variance * self.count + variance * count + delta * delta * self.count * count / total;
        self.mean += delta * count / total;
        self.variance = squares / total;
        self.count = total;
    }
}

/// The U-signal: the mean of DRIL's rewards over an episode (thesis equation 34), 1 where the members of the ensemble
/// never disagreed.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct USignal {
    /// Sum of rewards and number of steps of the running episode, one pair an environment.
    running: Vec<(f64, u64)>,
}

impl USignal {
    /// For `envs` environments at the start of an episode.
    pub fn new(envs: usize) -> Self {
        Self { running: vec![(0.0, 0); envs] }
    }

    /// Takes the rewards of a rollout (`[step][environment]`, before they are scaled) and gives the signal of every
    /// episode that ended in it, in the order they ended. `ends` (same layout) is true where a step was the last of its
    /// episode.
    pub fn observe(&mut self, rewards: &[f32], ends: &[bool]) -> Vec<f64> {
        let mut signals = Vec::new();
        let envs = self.running.len();
        for (at, (reward, end)) in rewards.iter().zip(ends).enumerate() {
            let (sum, steps) = &mut self.running[at % envs];
            *sum += f64::from(*reward);
            *steps += 1;
            if *end {
                signals.push(*sum / *steps as f64);
                (*sum, *steps) = (0.0, 0);
            }
        }
        signals
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    /// Mean and population variance of a list with the first guess in it, by the book.
    fn moments(seen: &[f64]) -> (f64, f64) {
        let total = RewardNormalizer::PRIOR + seen.len() as f64;
        let mean = seen.iter().sum::<f64>() / total;
        let squares = RewardNormalizer::PRIOR * (1.0 + mean * mean)
            + seen.iter().map(|value| (value - mean).powi(2)).sum::<f64>();
        (mean, squares / total)
    }

    #[test]
    fn rewards_are_divided_by_the_deviation_of_their_discounted_sum() {
        let mut normalizer = RewardNormalizer::new(1, 0.5);
        let mut rewards = [1.0, -1.0, 1.0];
        normalizer.normalize(&mut rewards, &[false, true, false]);
        // Sums: 1, 1·0.5 - 1 = -0.5, and 1 again since an episode starts.
        let (_, variance) = moments(&[1.0, -0.5, 1.0]);
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
    fn the_signal_of_an_episode_is_its_mean_reward_across_rollouts() {
        let mut signal = USignal::new(2);
        assert_eq!(signal.observe(&[1.0, -1.0, 1.0, -1.0], &[false, false, false, true]), [-1.0]);
        assert_eq!(signal.observe(&[-1.0, 1.0], &[true, true]), [1.0 / 3.0, 1.0]);
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
            let (mean, variance) = moments(&seen);
            prop_assert!((normalizer.mean - mean).abs() < 1e-9);
            prop_assert!((normalizer.variance - variance).abs() < 1e-9);
        }
    }
}
