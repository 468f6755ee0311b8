//! The settings of LunarLander: `env: { lunar-lander: ... }` of the pipeline file.

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

/// Settings of LunarLander: gym's LunarLanderContinuous-v2, whose rules Gymnasium's v3 shares.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields, default)]
pub struct LunarLanderConfig {
    /// Steps (1/50 s each) after which an episode is truncated.
    pub time_limit: u32,
}

impl Default for LunarLanderConfig {
    fn default() -> Self {
        Self { time_limit: 1000 }
    }
}

impl LunarLanderConfig {
    /// See [`crate::EnvSettings::check`].
    pub(super) fn check(&self) -> Vec<(String, String)> {
        let zero =
            (self.time_limit == 0).then(|| ("time_limit".into(), "0 steps, expected at least 1".into()));
        zero.into_iter().collect()
    }
}
