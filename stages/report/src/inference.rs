//! Inference from mean scores: 95 % intervals and tests of differences, by the t distribution over independent values.
//!
//! The independent values are the means of trainings if there are several, otherwise the episodes of the one training;
//! the latter tell how this policy does on other tracks, and nothing about other trainings. Results pass through functions
//! whose last bits depend on the processor, so they are to be rounded wherever they are written.

use statrs::distribution::{ContinuousCDF, StudentsT};

/// Fewer episodes of one training have no interval: scores have two peaks, and the interval would be too narrow.
pub const FEWEST_EPISODES: usize = 30;
/// Fewer trainings have no interval.
pub const FEWEST_TRAININGS: usize = 3;

/// The population that an interval refers to.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum Over {
    /// Other trainings of the same kind.
    Trainings,
    /// Other tracks (or levels), for this very policy.
    Episodes,
}

/// A mean, and its 95 % interval where there is one.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Estimate {
    /// The mean of the means of the trainings.
    pub mean: f64,
    /// Half the width of the interval around the mean.
    pub half_width: Option<f64>,
    /// How many trainings there are.
    pub trainings: usize,
    /// How many episodes all of them have.
    pub episodes: usize,
    /// The population that the interval refers to.
    pub over: Over,
}

impl Estimate {
    /// Of the scores of trainings; `None` where one has no scores, or there is no training.
    pub fn of(trainings: &[&[f64]]) -> Option<Self> {
        let means = trainings.iter().map(|scores| mean(scores)).collect::<Option<Vec<f64>>>()?;
        let over = if means.len() == 1 { Over::Episodes } else { Over::Trainings };
        let episodes = trainings.iter().map(|scores| scores.len()).sum();
        let half_width = match over {
            Over::Episodes if episodes < FEWEST_EPISODES => None,
            Over::Trainings if means.len() < FEWEST_TRAININGS => None,
            Over::Episodes => half_width(trainings[0]),
            Over::Trainings => half_width(&means),
        };
        Some(Self { mean: mean(&means)?, half_width, trainings: means.len(), episodes, over })
    }
}

/// The arithmetic mean; `None` of nothing.
pub fn mean(values: &[f64]) -> Option<f64> {
    crate::stats::Summary::of(values).map(|summary| summary.mean)
}

/// The standard error of the mean of independent values; `None` for fewer than two.
pub fn standard_error(values: &[f64]) -> Option<f64> {
    let summary = crate::stats::Summary::of(values).filter(|summary| summary.episodes > 1)?;
    let n = summary.episodes as f64;
    Some(summary.std / (n - 1.0).sqrt())
}

/// Half the width of the 95 % interval of the mean of independent values; `None` for fewer than two.
pub fn half_width(values: &[f64]) -> Option<f64> {
    Some(standard_error(values)? * quantile((values.len() - 1) as f64, 0.05))
}

/// The value that a t variable of these degrees of freedom exceeds, either way, with this probability.
pub fn quantile(degrees: f64, outside: f64) -> f64 {
    StudentsT::new(0.0, 1.0, degrees).map_or(f64::INFINITY, |t| t.inverse_cdf(1.0 - outside / 2.0))
}

/// The probability that the mean of independent values comes out above `limit` by as much as it does, or more, where the
/// truth is `limit`. Without any spread it is 0 above the limit, 1 below, and a half at it; `None` for fewer than two.
pub fn p_above(values: &[f64], limit: f64) -> Option<f64> {
    let (mean, error) = (mean(values)?, standard_error(values)?);
    if error == 0.0 {
        return Some(if mean > limit { 0.0 } else { f64::from(u8::from(mean < limit)).max(0.5) });
    }
    let t = StudentsT::new(0.0, 1.0, (values.len() - 1) as f64).ok()?;
    Some(t.sf((mean - limit) / error))
}

/// The p values of a family of tests, each as large as it must be for the chance of one false finding among all of them
/// to stay below the level at which it is read (Holm, Scandinavian Journal of Statistics 6, 1979). Order is kept.
pub fn holm(p: &[f64]) -> Vec<f64> {
    let mut order: Vec<usize> = (0..p.len()).collect();
    order.sort_by(|a, b| p[*a].total_cmp(&p[*b]).then(a.cmp(b)));
    let mut adjusted = vec![1.0; p.len()];
    let mut least = 0.0_f64;
    for (rank, index) in order.into_iter().enumerate() {
        least = least.max(((p.len() - rank) as f64 * p[index]).min(1.0));
        adjusted[index] = least;
    }
    adjusted
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    #[test]
    fn intervals_have_the_widths_of_the_t_distribution() {
        // Tables of the t distribution: 2.776 for 4 degrees of freedom, 1.984 for 99.
        assert!((quantile(4.0, 0.05) - 2.776_445).abs() < 1e-5);
        assert!((quantile(99.0, 0.05) - 1.984_217).abs() < 1e-5);
        let five: Vec<Vec<f64>> = (0..5).map(|n| vec![f64::from(n); 3]).collect();
        let five: Vec<&[f64]> = five.iter().map(Vec::as_slice).collect();
        let estimate = Estimate::of(&five).unwrap();
        // The sample deviation of 0..=4 is 1.5811; by the root of 5 and 2.7764, 1.2417 of it is the half width.
        assert!((estimate.half_width.unwrap() - 1.241_66 * 1.581_139).abs() < 1e-3);
        assert_eq!((estimate.over, estimate.trainings, estimate.episodes), (Over::Trainings, 5, 15));
    }

    #[test]
    fn few_episodes_and_two_trainings_have_no_interval() {
        let scores: Vec<f64> = (0..30).map(f64::from).collect();
        assert_eq!(Estimate::of(&[&scores[..29]]).unwrap().half_width, None);
        assert_eq!(Estimate::of(&[&scores, &scores]).unwrap().half_width, None);
        let one = Estimate::of(&[&scores]).unwrap();
        assert!(one.over == Over::Episodes && one.half_width.is_some());
    }

    #[test]
    fn holm_multiplies_the_smallest_by_all_and_never_orders_anew() {
        let close = |a: Vec<f64>, b: &[f64]| a.iter().zip(b).all(|(a, b)| (a - b).abs() < 1e-12);
        assert!(close(holm(&[0.01, 0.04, 0.03]), &[0.03, 0.06, 0.06]));
        assert!(close(holm(&[0.5, 0.9]), &[1.0, 1.0]));
        assert!(holm(&[]).is_empty());
    }

    proptest! {
        #[test]
        fn a_value_lies_outside_the_interval_exactly_where_the_two_sided_test_refuses_it(
            values in prop::collection::vec(-1e3..1e3_f64, 3..20), limit in -1e3..1e3_f64,
        ) {
            let (mean, half) = (mean(&values).unwrap(), half_width(&values).unwrap());
            let above = p_above(&values, limit).unwrap();
            let outside = (mean - limit).abs() > half * (1.0 + 1e-6);
            let inside = (mean - limit).abs() < half * (1.0 - 1e-6);
            let refused = 2.0 * above.min(1.0 - above) < 0.05;
            prop_assert!((refused || !outside) && !(refused && inside), "{above} {mean} {half}");
        }
    }
}
