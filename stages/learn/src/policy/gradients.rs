//! Gradients of a loss with respect to a policy's outputs for a batch.

use super::distribution::RowGradient;
use super::weights::Weights;
use super::{Head, Policy, Row};

/// Gradients with respect to the outputs of a policy's head and critic, filled row by row.
#[derive(Clone, Debug)]
pub struct OutputGradients {
    /// For each output of the head, [rows, outputs].
    pub(super) heads: Vec<Vec<f32>>,
    /// With respect to a Gaussian's log standard deviations, summed over rows; none if the loss does not depend on them.
    pub(super) log_std: Option<Vec<f64>>,
    /// With respect to the state values, [rows]; none if the loss does not depend on them.
    pub(super) values: Option<Vec<f32>>,
    /// Length of a row of each output of the head.
    len: usize,
}

impl OutputGradients {
    /// Zeros, for `rows` rows of outputs of `policy`.
    pub fn new(policy: &Policy, rows: usize) -> Self {
        let len = policy.architecture.actions.outputs();
        let heads = policy.head.nodes().iter().map(|_| vec![0.0; rows * len]).collect();
        let log_std = matches!(policy.head, Head::Gaussian { .. }).then(|| vec![0.0; len]);
        Self { heads, log_std, values: Some(vec![0.0; rows]), len }
    }

    /// The same for a loss that depends on the mean action only.
    pub fn of_mean(policy: &Policy, rows: usize) -> Self {
        Self { log_std: None, values: None, ..Self::new(policy, rows) }
    }

    /// Adds the gradients of `weights.log_prob` · ln p(sample) + `weights.entropy` · entropy of a row's distribution.
    pub fn add_row(&mut self, row: &Row<'_>, at: usize, sample: &[f32], weights: Weights) {
        row.add_gradient(sample, weights, self.row(at));
    }

    /// Adds `weight` times the gradients of a row's behaviour cloning loss, and returns that loss.
    pub fn add_cloning_row(&mut self, row: &Row<'_>, at: usize, demonstrated: &[f32], weight: f64) -> f64 {
        row.add_cloning_gradient(demonstrated, weight, self.row(at));
        row.cloning_loss(demonstrated)
    }

    /// Sets the gradient of a row's state value.
    pub fn set_value(&mut self, at: usize, gradient: f64) {
        if let Some(values) = &mut self.values {
            values[at] = gradient as f32;
        }
    }

    fn row(&mut self, at: usize) -> RowGradient<'_> {
        let range = at * self.len..(at + 1) * self.len;
        let mut heads = self.heads.iter_mut().map(|head| &mut head[range.clone()]);
        RowGradient {
            first: heads.next().unwrap_or_default(),
            second: heads.next().unwrap_or_default(),
            shared: self.log_std.as_deref_mut().unwrap_or_default(),
        }
    }
}
