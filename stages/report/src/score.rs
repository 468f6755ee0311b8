//! A `mean ± std` as it is shown to people: rounded to whole numbers, as in the thesis.

use crate::number::rounded;
use crate::reference::Row;
use crate::stats::Summary;

/// A mean, and a standard deviation where one is known.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(crate) struct Score {
    pub(crate) mean: String,
    pub(crate) std: Option<String>,
}

impl Score {
    /// What this run measured.
    pub(crate) fn measured(summary: &Summary) -> Self {
        Self { mean: rounded(summary.mean), std: Some(rounded(summary.std)) }
    }

    /// What was published; `None` where no mean was.
    pub(crate) fn published(row: &Row) -> Option<Self> {
        let mean = rounded(row.mean.as_ref()?.value);
        Some(Self { mean, std: row.std.as_ref().map(|std| rounded(std.value)) })
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
