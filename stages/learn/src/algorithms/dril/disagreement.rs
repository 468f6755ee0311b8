//! The cost of an action in DRIL: the disagreement of the ensemble's members on it, the threshold above which they count
//! as disagreeing, and the resulting reward.
//!
//! Pure functions from the ensemble's outputs to costs and rewards. All sums are in `f64`, in a fixed order.

use dril_kinds::RewardScheme;

/// Outputs of all members of an ensemble for a list of samples: actions (continuous) or logits (discrete).
#[derive(Clone, Debug, PartialEq)]
pub struct MemberOutputs {
    values: Vec<f32>,
    members: usize,
    dims: usize,
}

impl MemberOutputs {
    /// Takes `values` in the order `[member][sample][dimension]`; `None` unless they are a whole number of samples.
    /// A covariance needs at least two members.
    pub fn new(values: Vec<f32>, members: usize, dims: usize) -> Option<Self> {
        let whole = members >= 2 && dims >= 1 && values.len().is_multiple_of(members * dims);
        whole.then_some(Self { values, members, dims })
    }

    /// Number of samples.
    pub fn samples(&self) -> usize {
        self.values.len() / (self.members * self.dims)
    }

    /// Values per output: action dimensions, or the number of discrete actions.
    pub fn dims(&self) -> usize {
        self.dims
    }

    /// The output of one member for one sample.
    fn answer(&self, member: usize, sample: usize) -> &[f32] {
        let at = (member * self.samples() + sample) * self.dims;
        &self.values[at..at + self.dims]
    }

    /// `a·S·aᵀ` for a continuous action `a`, where `S` is the sample covariance (divisor: members − 1) of the members'
    /// actions for `sample`; `a` and the members' actions are clamped to [-1, 1] first (thesis equation 33).
    ///
    /// The covariance is not centred on `a`, so `a = 0` has no cost, however much the members disagree.
    pub fn continuous_cost(&self, sample: usize, action: &[f32]) -> f64 {
        // a·S·aᵀ is the sample variance of the members' projections on a, which needs no matrix.
        variance((0..self.members).map(|member| {
            let answer = self.answer(member, sample);
            action.iter().zip(answer).map(|(a, m)| within(*a) * within(*m)).sum()
        }))
    }

    /// The same with a one-hot action, which leaves the sample variance of the members' raw logits of `action`
    /// (thesis Table 6).
    pub fn discrete_cost(&self, sample: usize, action: usize) -> f64 {
        variance((0..self.members).map(|member| f64::from(self.answer(member, sample)[action])))
    }
}

/// An action value, clamped to the environment's range.
fn within(value: f32) -> f64 {
    f64::from(value.clamp(-1.0, 1.0))
}

/// Sample variance with divisor n − 1, in two passes.
fn variance(values: impl ExactSizeIterator<Item = f64> + Clone) -> f64 {
    let count = values.len() as f64;
    let mean = values.clone().sum::<f64>() / count;
    values.map(|value| (value - mean) * (value - mean)).sum::<f64>() / (count - 1.0)
}

/// The `q`-quantile of `values` (`q` in 0..=1) with linear interpolation between the two nearest ranks, as in `numpy` and
/// R's type 7; `None` for no values.
pub fn quantile(values: &[f64], q: f64) -> Option<f64> {
    let mut sorted = values.to_vec();
    sorted.sort_by(f64::total_cmp);
    let rank = q * sorted.len().checked_sub(1)? as f64;
    let below = rank.floor() as usize;
    let above = rank.ceil() as usize;
    Some(sorted[below] + (sorted[above] - sorted[below]) * (rank - rank.floor()))
}

/// The reward of an action with this `cost`, for the threshold `limit`; a cost equal to the threshold counts as agreement.
pub fn reward(scheme: RewardScheme, cost: f64, limit: f64) -> f32 {
    match (cost > limit, scheme) {
        (_, RewardScheme::Constant) => 1.0,
        (true, _) => -1.0,
        (false, RewardScheme::PlusMinusOne) => 1.0,
        (false, RewardScheme::MinusOneToZero) => 0.0,
    }
}

/// The cost of each sample's action, `actions` being `[sample][dimension]`.
pub fn continuous_costs(outputs: &MemberOutputs, actions: &[f32]) -> Vec<f64> {
    actions
        .chunks_exact(outputs.dims())
        .enumerate()
        .map(|(sample, action)| outputs.continuous_cost(sample, action))
        .collect()
}

/// The cost of each sample's discrete action; one number per sample.
pub fn discrete_costs(outputs: &MemberOutputs, choices: &[f32]) -> Vec<f64> {
    choices
        .iter()
        .enumerate()
        .map(|(sample, choice)| outputs.discrete_cost(sample, *choice as usize))
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn near(seen: f64, expected: f64, within: f64) {
        assert!((seen - expected).abs() <= within, "{seen} is not {expected} within {within}");
    }

    /// One sample; a row a member.
    fn one_sample<const D: usize>(rows: &[[f32; D]]) -> MemberOutputs {
        MemberOutputs::new(rows.concat(), rows.len(), D).unwrap()
    }

    fn table_6() -> MemberOutputs {
        one_sample(&[
            [-6.1601, 1.6958, -24.5386, -38.3140],
            [-8.5653, 2.9279, -14.2508, -24.1290],
            [7.0254, -7.9456, -35.4550, -38.2695],
            [-6.5959, 1.9961, -19.2376, -23.1304],
            [-12.1714, -7.6832, -21.5352, -25.2002],
        ])
    }

    fn table_9() -> MemberOutputs {
        one_sample(&[
            [0.4865, 0.5586],
            [0.4770, 0.4287],
            [0.3953, 0.5147],
            [0.4320, 0.2766],
            [0.3994, 0.5370],
        ])
    }

    #[test]
    fn the_logit_variances_of_table_6_are_reproduced() {
        let outputs = table_6();
        for (action, expected) in [53.0532, 30.3411, 62.5860, 60.5056].into_iter().enumerate() {
            near(outputs.discrete_cost(0, action), expected, 2e-3);
        }
    }

    #[test]
    fn the_action_covariance_of_table_9_is_reproduced() {
        let outputs = table_9();
        let (main, side, both) = (
            outputs.continuous_cost(0, &[1.0, 0.0]),
            outputs.continuous_cost(0, &[0.0, 1.0]),
            outputs.continuous_cost(0, &[1.0, 1.0]),
        );
        near(main, 0.001_805_6, 1e-7);
        near(side, 0.013_302_4, 1e-7);
        near((both - main - side) / 2.0, -0.000_161_7, 1e-7);
    }

    #[test]
    fn an_action_of_zero_costs_nothing_and_saturated_actions_are_clamped() {
        let outputs = table_9();
        assert_eq!(outputs.continuous_cost(0, &[0.0, 0.0]), 0.0);
        assert_eq!(outputs.continuous_cost(0, &[7.0, -3.0]), outputs.continuous_cost(0, &[1.0, -1.0]));
        let saturated = one_sample(&[[1.5, 0.2], [9.0, 0.2], [1.0, 0.2]]);
        assert_eq!(saturated.continuous_cost(0, &[1.0, 0.0]), 0.0);
    }

    #[test]
    fn samples_are_told_apart() {
        // Two members, two samples, one dimension: [member][sample].
        let outputs = MemberOutputs::new(vec![0.0, 0.5, 0.0, -0.5], 2, 1).unwrap();
        assert_eq!(outputs.samples(), 2);
        assert_eq!(continuous_costs(&outputs, &[1.0, 1.0]), [0.0, 0.5]);
    }

    #[test]
    fn values_that_are_no_whole_number_of_samples_are_refused() {
        assert_eq!(MemberOutputs::new(vec![0.0; 7], 2, 2), None);
        assert_eq!(MemberOutputs::new(vec![0.0; 4], 1, 2), None, "one member has no covariance");
    }

    #[test]
    fn the_quantile_interpolates_between_ranks() {
        let values = [4.0, 1.0, 3.0, 2.0];
        assert_eq!(quantile(&values, 0.0), Some(1.0));
        assert_eq!(quantile(&values, 0.5), Some(2.5));
        assert_eq!(quantile(&values, 1.0), Some(4.0));
        near(quantile(&values, 0.98).unwrap(), 3.94, 1e-12);
        assert_eq!(quantile(&[7.0], 0.98), Some(7.0));
        assert_eq!(quantile(&[], 0.98), None);
    }

    #[test]
    fn a_choice_costs_the_variance_of_its_own_logit() {
        assert_eq!(discrete_costs(&table_6(), &[2.0]), [table_6().discrete_cost(0, 2)]);
    }

    #[test]
    fn a_cost_at_the_threshold_is_agreement() {
        assert_eq!(reward(RewardScheme::PlusMinusOne, 0.5, 0.5), 1.0);
        assert_eq!(reward(RewardScheme::PlusMinusOne, 0.6, 0.5), -1.0);
        assert_eq!(reward(RewardScheme::MinusOneToZero, 0.5, 0.5), 0.0);
        assert_eq!(reward(RewardScheme::MinusOneToZero, 0.6, 0.5), -1.0);
    }

    proptest! {
        #[test]
        fn the_cost_is_a_quadratic_form(
            members in proptest::collection::vec(proptest::array::uniform2(-0.99f32..0.99), 2..7),
            a in proptest::array::uniform2(-0.99f32..0.99),
        ) {
            let outputs = one_sample(&members);
            let cost = outputs.continuous_cost(0, &a);
            let half = outputs.continuous_cost(0, &[a[0] / 2.0, a[1] / 2.0]);
            prop_assert!(cost >= 0.0);
            prop_assert!((cost - 4.0 * half).abs() < 1e-5 * (1.0 + cost));
        }

        #[test]
        fn a_share_of_q_lies_at_or_below_the_quantile(
            values in proptest::collection::vec(-1e3f64..1e3, 1..200), q in 0.0f64..1.0,
        ) {
            let limit = quantile(&values, q).unwrap();
            let below = values.iter().filter(|value| **value <= limit).count();
            // The rank q·(n-1) is below the limit together with everything under it.
            prop_assert!(below as f64 >= (q * (values.len() - 1) as f64).floor() + 1.0 - 1e-9);
            prop_assert!((below as f64) <= values.len() as f64);
        }
    }
}
