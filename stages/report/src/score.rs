//! A `mean ± std` as it is shown to people: by default rounded to whole numbers, as in the thesis.

use crate::number::{fixed, rounded};
use crate::reference::{Published, Row};
use crate::stats::Summary;

/// A mean, and a standard deviation where one is known.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(crate) struct Score {
    pub(crate) mean: String,
    pub(crate) std: Option<String>,
}

impl Score {
    /// What this run measured, with this many decimals.
    pub(crate) fn measured(summary: &Summary, decimals: u8) -> Self {
        let number = |value: f64| fixed(value, decimals.into());
        Self { mean: number(summary.mean), std: Some(number(summary.std)) }
    }

    /// What was published, beside numbers with this many decimals; `None` where no mean was. Beside whole numbers it is
    /// one too; otherwise it keeps its digits, as nobody knows the digits that a published number lacks.
    pub(crate) fn published(row: &Row, decimals: u8) -> Option<Self> {
        let number = |number: &Published| match decimals {
            0 => rounded(number.value),
            _ => number.text.clone(),
        };
        Some(Self { mean: number(row.mean.as_ref()?), std: row.std.as_ref().map(number) })
    }

    /// With the standard deviation padded to `widest` characters, so that the signs of a column stand one under the
    /// other (`None`: no score of the column has one).
    pub(crate) fn padded(&self, widest: Option<usize>) -> String {
        match (&self.std, widest) {
            (Some(std), widest) => format!("{} ± {std:>1$}", self.mean, widest.unwrap_or(0)),
            (None, Some(widest)) => format!("{}{:2$}", self.mean, "", widest + 3),
            (None, None) => self.mean.clone(),
        }
    }
}
