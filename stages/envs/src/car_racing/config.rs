//! The settings of CarRacing: `env: { car-racing: ... }` of the pipeline file.

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

/// Settings of CarRacing.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields, default)]
pub struct CarRacingConfig {
    /// Which version's image and lap rule: `v0` is gym's original, which the thesis used; `v3` is Gymnasium's. Physics,
    /// tracks and rewards are the same.
    pub version: CarRacingVersion,
    /// Steps (1/50 s each) after which an episode is truncated.
    pub time_limit: u32,
    /// Fraction of the tiles, from 0 to 1, that must be visited before crossing the start line completes the lap.
    /// Default: 1 (every tile) for `v0`, 0.95 for `v3`.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub lap_complete_percent: Option<f64>,
}

/// Which version's image and lap rule.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "kebab-case")]
pub enum CarRacingVersion {
    /// gym up to 0.21: the camera follows the velocity, one sample per pixel, all tiles make a lap.
    #[default]
    V0,
    /// Gymnasium: the camera follows the hull, anti-aliased edges, 95 % of the tiles make a lap.
    V3,
}

impl Default for CarRacingConfig {
    fn default() -> Self {
        Self { version: CarRacingVersion::V0, time_limit: 1000, lap_complete_percent: None }
    }
}

impl CarRacingConfig {
    /// Fraction of the tiles that must be visited before the start line completes the lap; 1 where all are needed.
    pub fn lap_share(&self) -> f64 {
        self.lap_complete_percent.unwrap_or(match self.version {
            CarRacingVersion::V0 => 1.0,
            CarRacingVersion::V3 => 0.95,
        })
    }

    /// See [`crate::EnvSettings::check`].
    pub(super) fn check(&self) -> Vec<(String, String)> {
        let mut found = Vec::new();
        if self.time_limit == 0 {
            found.push(("time_limit".into(), "0 steps, expected at least 1".into()));
        }
        if let Some(share) = self.lap_complete_percent
            && !(0.0..=1.0).contains(&share)
        {
            let message = format!("{share}, expected a number from 0 to 1 (0.95 means 95 %)");
            found.push(("lap_complete_percent".into(), message));
        }
        found
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_lap_rule_follows_the_version_unless_it_is_given() {
        let of = |version, lap_complete_percent| {
            CarRacingConfig { version, lap_complete_percent, ..Default::default() }.lap_share()
        };
        assert_eq!(of(CarRacingVersion::V0, None), 1.0);
        assert_eq!(of(CarRacingVersion::V3, None), 0.95);
        assert_eq!(of(CarRacingVersion::V3, Some(1.0)), 1.0);
    }
}
