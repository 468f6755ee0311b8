//! What a plan warns of: a pipeline that can run, but probably does not do what was meant.

use std::fmt;

use serde::{Deserialize, Serialize};

/// A warning.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Warning {
    /// What was seen.
    pub message: String,
    /// How to change it.
    pub hint: String,
}

impl fmt::Display for Warning {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "warning: {}\n  = hint: {}", self.message, self.hint)
    }
}
