//! The weights of a distribution's quantities in a loss, and the rounding of their gradients.

/// Derivatives of a loss with respect to the log-density and the entropy of one row.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Weights {
    /// With respect to the log-density of the row's sample.
    pub log_prob: f64,
    /// With respect to the row's entropy.
    pub entropy: f64,
}

/// Adds in double precision and rounds once.
pub(super) fn add(into: &mut f32, value: f64) {
    *into = (f64::from(*into) + value) as f32;
}
