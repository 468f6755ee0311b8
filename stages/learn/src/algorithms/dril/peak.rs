//! DRIL-peak: the weights with the highest moving average of the environment's score (thesis Algorithm 2).
//!
//! DRIL does not learn from this score, so selecting by it uses the true reward, and the selected mean is biased upwards.
//! Evaluate the weights on new tracks.

use std::collections::VecDeque;

use serde::{Deserialize, Serialize};

/// Tracks the moving average over finished episodes and its maximum.
///
/// Checked once per update, over the last `window` episodes of all environments in the order they finished, or over fewer
/// while fewer have finished, as in the reference code (whose best Beta policy stems from the 8 episodes of the first
/// update).
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct PeakTracker {
    window: usize,
    scores: VecDeque<f64>,
    changed: bool,
    best: Option<Peak>,
}

/// A highest moving average.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Peak {
    /// The mean score.
    pub mean: f64,
    /// The number of episodes in the mean.
    pub episodes: usize,
    /// The update before which it was reached, from 0.
    pub update: u64,
}

impl PeakTracker {
    /// A tracker over `window` episodes (at least 1), without episodes yet.
    pub fn new(window: usize) -> Self {
        Self { window: window.max(1), scores: VecDeque::new(), changed: false, best: None }
    }

    /// Records the score of a finished episode.
    pub fn finished(&mut self, score: f64) {
        if self.scores.len() == self.window {
            self.scores.pop_front();
        }
        self.scores.push_back(score);
        self.changed = true;
    }

    /// The current moving average; `None` before the first episode has finished.
    pub fn mean(&self) -> Option<f64> {
        let count = self.scores.len();
        (count > 0).then(|| self.scores.iter().sum::<f64>() / count as f64)
    }

    /// The number of episodes in [`Self::mean`].
    pub fn episodes(&self) -> usize {
        self.scores.len()
    }

    /// True if the moving average is at least its maximum so far. False if no episode has finished since the last check:
    /// the current weights have no score yet.
    pub fn check(&mut self, update: u64) -> bool {
        let changed = std::mem::take(&mut self.changed);
        let Some(mean) = self.mean().filter(|_| changed) else { return false };
        let highest = self.best.is_none_or(|best| mean >= best.mean);
        if highest {
            self.best = Some(Peak { mean, episodes: self.episodes(), update });
        }
        highest
    }

    /// Resets the maximum, so that the next average becomes the maximum.
    pub fn forget(&mut self) {
        self.best = None;
    }

    /// The highest average so far.
    pub fn best(&self) -> Option<Peak> {
        self.best
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn tracker(window: usize, scores: &[f64]) -> PeakTracker {
        let mut tracker = PeakTracker::new(window);
        scores.iter().for_each(|score| tracker.finished(*score));
        tracker
    }

    #[test]
    fn the_mean_is_over_the_last_window() {
        let tracker = tracker(2, &[100.0, 1.0, 2.0]);
        assert_eq!(tracker.mean(), Some(1.5));
        assert_eq!(tracker.episodes(), 2);
    }

    #[test]
    fn a_later_lower_mean_is_no_peak_and_an_equal_one_is() {
        let mut tracker = tracker(1, &[5.0]);
        assert!(tracker.check(0));
        tracker.finished(4.0);
        assert!(!tracker.check(1));
        tracker.finished(5.0);
        assert!(tracker.check(2));
        assert_eq!(tracker.best(), Some(Peak { mean: 5.0, episodes: 1, update: 2 }));
    }

    #[test]
    fn an_update_without_a_finished_episode_is_no_peak() {
        let mut tracker = PeakTracker::new(10);
        assert!(!tracker.check(0));
        tracker.finished(5.0);
        assert!(tracker.check(1));
        assert!(!tracker.check(2), "the mean is the same, but these weights did not earn it");
        assert_eq!(tracker.best().unwrap().update, 1);
    }

    #[test]
    fn fewer_episodes_than_the_window_count_and_are_counted() {
        let mut tracker = tracker(10, &[-10.0, -20.0, -30.0]);
        assert!(tracker.check(0));
        assert_eq!(tracker.best(), Some(Peak { mean: -20.0, episodes: 3, update: 0 }));
    }

    #[test]
    fn what_is_forgotten_can_be_beaten_by_less() {
        let mut tracker = tracker(1, &[5.0]);
        tracker.check(0);
        tracker.forget();
        tracker.finished(1.0);
        assert!(tracker.check(100));
    }
}
