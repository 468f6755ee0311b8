//! The U-signal: DRIL's mean reward per episode.

use serde::{Deserialize, Serialize};

/// The U-signal: the mean of DRIL's rewards over an episode (thesis equation 34); 1 if the ensemble never disagreed.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct USignal {
    /// Sum of rewards and number of steps of the running episode, one entry per environment.
    running: Vec<(f64, u64)>,
}

impl USignal {
    /// For `envs` environments, at the start of an episode.
    pub fn new(envs: usize) -> Self {
        Self { running: vec![(0.0, 0); envs] }
    }

    /// Adds the rewards of a rollout (`[step][environment]`, before scaling) and returns the signal of each episode that
    /// ended in it, in the order they ended. `dones` (same layout) is true for the last step of an episode.
    pub fn observe(&mut self, rewards: &[f32], dones: &[bool]) -> Vec<f64> {
        let mut signals = Vec::new();
        let envs = self.running.len();
        for (at, (reward, done)) in rewards.iter().zip(dones).enumerate() {
            let (sum, steps) = &mut self.running[at % envs];
            *sum += f64::from(*reward);
            *steps += 1;
            if *done {
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

    #[test]
    fn the_signal_of_an_episode_is_its_mean_reward_across_rollouts() {
        let mut signal = USignal::new(2);
        assert_eq!(signal.observe(&[1.0, -1.0, 1.0, -1.0], &[false, false, false, true]), [-1.0]);
        assert_eq!(signal.observe(&[-1.0, 1.0], &[true, true]), [1.0 / 3.0, 1.0]);
    }
}
