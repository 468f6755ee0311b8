//! Mean and population standard deviation. The sums run in the order of the values, so equal inputs give equal bits.

/// What a cell of a table says about its episodes.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Summary {
    /// The arithmetic mean of the scores.
    pub mean: f64,
    /// The population standard deviation: the root of the mean squared deviation (divisor n, "ddof 0"). It is the
    /// statistic of the thesis's tables; it describes the spread of the episodes and is no error of the mean.
    pub std: f64,
    /// How many episodes there are, at least 1.
    pub episodes: usize,
}

impl Summary {
    /// The summary of `scores`; `None` where there are none, or where they are not finite or too large for `f64`.
    pub fn of(scores: &[f64]) -> Option<Self> {
        let episodes = scores.len();
        let n = episodes as f64;
        let lowest = scores.iter().copied().reduce(f64::min)?;
        let highest = scores.iter().copied().reduce(f64::max)?;
        let sum = sum(scores.iter().copied());
        if !sum.is_finite() {
            return None;
        }
        // Rounding of sum/n must not push the mean out of the data: equal scores have exactly that mean, and std 0.
        let mean = (sum / n).clamp(lowest, highest);
        let std = (self::sum(scores.iter().map(|score| (score - mean).powi(2))) / n).sqrt();
        std.is_finite().then_some(Self { mean, std, episodes })
    }
}

/// The sum with Neumaier's correction (ZAMM 54, 1974): it loses no digits where large and small values meet.
fn sum(values: impl Iterator<Item = f64>) -> f64 {
    let (mut total, mut lost) = (0.0_f64, 0.0_f64);
    for value in values {
        let next = total + value;
        lost += if total.abs() >= value.abs() { (total - next) + value } else { (value - next) + total };
        total = next;
    }
    total + lost
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    #[test]
    fn the_std_divides_by_n_and_not_by_n_minus_one() {
        let summary = Summary::of(&[2.0, 4.0, 4.0, 4.0, 5.0, 5.0, 7.0, 9.0]).unwrap();
        assert_eq!(summary, Summary { mean: 5.0, std: 2.0, episodes: 8 });
    }

    #[test]
    fn no_scores_and_scores_beyond_f64_have_no_summary() {
        for scores in [&[] as &[f64], &[f64::MAX, f64::MAX], &[f64::MAX, -f64::MAX], &[1.0, f64::NAN]] {
            assert_eq!(Summary::of(scores), None, "{scores:?}");
        }
    }

    #[test]
    fn small_scores_survive_between_large_ones() {
        assert_eq!(Summary::of(&[1e16, 3.0, -1e16]).unwrap().mean, 1.0);
    }

    proptest! {
        #[test]
        fn equal_scores_have_that_mean_and_no_spread(score in -1e6..1e6_f64, n in 1..200_usize) {
            let summary = Summary::of(&vec![score; n]).unwrap();
            prop_assert_eq!(summary, Summary { mean: score, std: 0.0, episodes: n });
        }

        #[test]
        fn the_mean_lies_in_the_data_and_the_std_within_half_its_range(
            scores in prop::collection::vec(-1e6..1e6_f64, 1..100),
        ) {
            let summary = Summary::of(&scores).unwrap();
            let lowest = scores.iter().copied().fold(f64::INFINITY, f64::min);
            let highest = scores.iter().copied().fold(f64::NEG_INFINITY, f64::max);
            prop_assert!(lowest <= summary.mean && summary.mean <= highest);
            // Popoviciu's inequality.
            prop_assert!(summary.std <= (highest - lowest) / 2.0 * (1.0 + 1e-12));
        }

        #[test]
        fn shifting_all_scores_shifts_the_mean_and_keeps_the_std(
            scores in prop::collection::vec(-1e3..1e3_f64, 1..100),
            shift in -1e3..1e3_f64,
        ) {
            let before = Summary::of(&scores).unwrap();
            let shifted: Vec<f64> = scores.iter().map(|score| score + shift).collect();
            let after = Summary::of(&shifted).unwrap();
            prop_assert!((after.mean - before.mean - shift).abs() < 1e-9);
            prop_assert!((after.std - before.std).abs() < 1e-9);
        }

        #[test]
        fn pooling_two_sets_agrees_with_the_law_of_total_variance(
            a in prop::collection::vec(-1e3..1e3_f64, 1..50),
            b in prop::collection::vec(-1e3..1e3_f64, 1..50),
        ) {
            let (x, y) = (Summary::of(&a).unwrap(), Summary::of(&b).unwrap());
            let all = Summary::of(&[a, b].concat()).unwrap();
            let (p, q) = (x.episodes as f64 / all.episodes as f64, y.episodes as f64 / all.episodes as f64);
            let variance = p * x.std.powi(2) + q * y.std.powi(2) + p * q * (x.mean - y.mean).powi(2);
            prop_assert!((all.mean - (p * x.mean + q * y.mean)).abs() < 1e-9);
            prop_assert!((all.std.powi(2) - variance).abs() < 1e-6);
        }
    }
}
