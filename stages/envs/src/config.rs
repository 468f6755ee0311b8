//! `env:` of the pipeline file.

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use crate::car_racing::CarRacing;
use crate::gymnasium::{self, GymnasiumConfig};
use crate::lunar_lander::LunarLander;
use crate::{ActionSpace, Env, EnvError, ObservationSpace};

/// Which environment, and its settings.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "kebab-case", deny_unknown_fields)]
pub enum EnvConfig {
    /// The car on a random track, seen from above.
    CarRacing(CarRacingConfig),
    /// The lander with two engines over a random ground, seen as 8 numbers.
    LunarLander(LunarLanderConfig),
    /// An environment of Gymnasium or the Arcade Learning Environment, played by Python.
    Gymnasium(GymnasiumConfig),
}

impl Default for EnvConfig {
    fn default() -> Self {
        Self::CarRacing(CarRacingConfig::default())
    }
}

/// Settings of CarRacing.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields, default)]
pub struct CarRacingConfig {
    /// Whose picture and rules: `v0` is gym's original, which the thesis used; `v3` is Gymnasium's. Physics, tracks and
    /// rewards are the same.
    pub version: CarRacingVersion,
    /// Steps (1/50 s each) after which an episode is cut off.
    pub time_limit: u32,
    /// The part of the tiles, from 0 to 1, that must be visited before crossing the start line ends the lap. Left out:
    /// every tile must be visited for `v0`, 0.95 for `v3`.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub lap_complete_percent: Option<f64>,
}

/// Settings of LunarLander: gym's LunarLanderContinuous-v2, which Gymnasium's v3 plays alike.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields, default)]
pub struct LunarLanderConfig {
    /// Steps (1/50 s each) after which an episode is cut off.
    pub time_limit: u32,
}

impl Default for LunarLanderConfig {
    fn default() -> Self {
        Self { time_limit: 1000 }
    }
}

impl LunarLanderConfig {
    fn check(&self) -> Vec<(String, String)> {
        let zero = (self.time_limit == 0)
            .then(|| ("lunar-lander.time_limit".into(), "0 steps, expected at least 1".into()));
        zero.into_iter().collect()
    }
}

/// Whose picture and rules.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "kebab-case")]
pub enum CarRacingVersion {
    /// gym up to 0.21: the camera follows the velocity, one sample per pixel, all tiles make a lap.
    #[default]
    V0,
    /// Gymnasium: the camera follows the hull, smooth edges, 95 % of the tiles make a lap.
    V3,
}

impl Default for CarRacingConfig {
    fn default() -> Self {
        Self { version: CarRacingVersion::V0, time_limit: 1000, lap_complete_percent: None }
    }
}

impl CarRacingConfig {
    /// The part of the tiles that must be visited before the start line ends the lap; 1 where all are needed.
    pub fn lap_share(&self) -> f64 {
        self.lap_complete_percent.unwrap_or(match self.version {
            CarRacingVersion::V0 => 1.0,
            CarRacingVersion::V3 => 0.95,
        })
    }

    fn check(&self) -> Vec<(String, String)> {
        let mut found = Vec::new();
        if self.time_limit == 0 {
            found.push(("car-racing.time_limit".into(), "0 steps, expected at least 1".into()));
        }
        if let Some(share) = self.lap_complete_percent
            && !(0.0..=1.0).contains(&share)
        {
            let message = format!("{share}, expected a number from 0 to 1 (0.95 means 95 %)");
            found.push(("car-racing.lap_complete_percent".into(), message));
        }
        found
    }
}

impl EnvConfig {
    /// The environment, before its first episode.
    ///
    /// # Errors
    /// As [`EnvConfig::build_several`].
    pub fn build(&self) -> Result<Box<dyn Env>, EnvError> {
        self.build_several(1, 1)?.pop().ok_or(EnvError::NotStarted)
    }

    /// `count` environments, before their first episodes. Those that other processes play share `workers` of these.
    ///
    /// # Errors
    /// The first problem that [`EnvConfig::check`] finds, or what a process needs is missing.
    pub fn build_several(&self, count: usize, workers: usize) -> Result<Vec<Box<dyn Env>>, EnvError> {
        if let Some((field, message)) = self.check().into_iter().next() {
            return Err(EnvError::Config { field, message });
        }
        match self {
            Self::CarRacing(config) => {
                let env = |_| Box::new(CarRacing::new(config.clone())) as Box<dyn Env>;
                Ok((0..count).map(env).collect())
            }
            Self::LunarLander(config) => {
                let env = |_| Box::new(LunarLander::new(config.clone())) as Box<dyn Env>;
                Ok((0..count).map(env).collect())
            }
            Self::Gymnasium(config) => gymnasium::build(config, count, workers),
        }
    }

    /// What the environment shows and takes, without building it. Some ids of Gymnasium have to be looked up, which
    /// takes a Python.
    ///
    /// # Errors
    /// There is no such Python, or no such id.
    pub fn spaces(&self) -> Result<(ObservationSpace, ActionSpace), EnvError> {
        match self {
            Self::CarRacing(_) => Ok(CarRacing::SPACES),
            Self::LunarLander(_) => Ok(LunarLander::SPACES),
            Self::Gymnasium(config) => gymnasium::spaces(config),
        }
    }

    /// What the values or choices of an action do, for people; may be fewer than there are.
    pub fn action_labels(&self) -> Vec<String> {
        let labels: &[&str] = match self {
            Self::CarRacing(_) => &["steer", "brake | gas"],
            Self::LunarLander(_) => &["main engine", "left | right"],
            Self::Gymnasium(config) => config.action_labels(),
        };
        labels.iter().map(|label| (*label).to_owned()).collect()
    }

    /// Steps in a second of the environment's own time.
    pub fn steps_per_second(&self) -> f64 {
        match self {
            Self::CarRacing(_) | Self::LunarLander(_) => 50.0,
            Self::Gymnasium(config) => config.steps_per_second(),
        }
    }

    /// Width over height of a picture for people.
    pub fn picture_ratio(&self) -> f64 {
        match self {
            Self::CarRacing(_) => 1.25,
            Self::LunarLander(_) => 1.5,
            Self::Gymnasium(config) => config.picture_ratio(),
        }
    }

    /// Every field out of range: its dotted path, and what was seen and expected.
    pub fn check(&self) -> Vec<(String, String)> {
        match self {
            Self::CarRacing(config) => config.check(),
            Self::LunarLander(config) => config.check(),
            Self::Gymnasium(config) => config.check(),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_field_has_a_default() {
        let config: EnvConfig = serde_json::from_str(r#"{"car-racing": {}}"#).unwrap();
        assert_eq!(config, EnvConfig::default());
        assert!(config.check().is_empty());
        assert_eq!(
            serde_json::to_string(&config).unwrap(),
            r#"{"car-racing":{"version":"v0","time_limit":1000}}"#
        );
    }

    #[test]
    fn the_lander_has_a_time_limit_of_its_own() {
        let config: EnvConfig = serde_json::from_str(r#"{"lunar-lander": {}}"#).unwrap();
        assert_eq!(serde_json::to_string(&config).unwrap(), r#"{"lunar-lander":{"time_limit":1000}}"#);
        let config = EnvConfig::LunarLander(LunarLanderConfig { time_limit: 0 });
        assert_eq!(config.check()[0].0, "lunar-lander.time_limit");
    }

    #[test]
    fn unknown_fields_and_versions_are_refused() {
        for text in [
            r#"{"car-racing": {"timelimit": 3}}"#,
            r#"{"car-racing": {"version": "v1"}}"#,
            r#"{"lander": {}}"#,
        ] {
            assert!(serde_json::from_str::<EnvConfig>(text).is_err(), "{text}");
        }
    }

    #[test]
    fn all_fields_out_of_range_are_reported_with_their_paths() {
        let config = EnvConfig::CarRacing(CarRacingConfig {
            time_limit: 0,
            lap_complete_percent: Some(f64::NAN),
            ..CarRacingConfig::default()
        });
        let fields: Vec<_> = config.check().into_iter().map(|(field, _)| field).collect();
        assert_eq!(fields, ["car-racing.time_limit", "car-racing.lap_complete_percent"]);
        assert!(config.build().is_err());
    }

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
