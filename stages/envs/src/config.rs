//! `env:` of the pipeline file: which environments there are.
//!
//! An environment is registered by one line in [`environments!`]. Everything else belongs to the environment: its
//! settings, their checks, its spaces, and how it is built ([`EnvSettings`]).

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use crate::car_racing::CarRacingConfig;
use crate::gymnasium::GymnasiumConfig;
use crate::lunar_lander::LunarLanderConfig;
use crate::{ActionSpace, Env, EnvError, EnvSettings, ObservationSpace};

/// Declares [`EnvConfig`]: one line per environment, with its name in the pipeline file (in kebab-case), its
/// description, and the type of its settings.
macro_rules! environments {
    ($($(#[$about:meta])* $name:ident($settings:ty),)+) => {
        /// Which environment, and its settings.
        #[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
        #[serde(rename_all = "kebab-case", deny_unknown_fields)]
        pub enum EnvConfig {
            $($(#[$about])* $name($settings),)+
        }

        impl EnvConfig {
            fn settings(&self) -> &dyn EnvSettings {
                match self {
                    $(Self::$name(settings) => settings,)+
                }
            }
        }
    };
}

environments! {
    /// CarRacing: a car on a random track, seen from above.
    CarRacing(CarRacingConfig),
    /// LunarLander with continuous actions: a lander with two engines above random terrain, observed as 8 numbers.
    LunarLander(LunarLanderConfig),
    /// An environment of Gymnasium or the Arcade Learning Environment, run by Python.
    Gymnasium(GymnasiumConfig),
}

impl Default for EnvConfig {
    fn default() -> Self {
        Self::CarRacing(CarRacingConfig::default())
    }
}

impl EnvConfig {
    /// The name in the pipeline file.
    pub fn name(&self) -> String {
        // The name is the key of the only field, so it cannot differ from what serde reads.
        let value = serde_json::to_value(self).unwrap_or_default();
        value.as_object().and_then(|fields| fields.keys().next().cloned()).unwrap_or_default()
    }

    /// Every field that is out of range: its dotted path, and what was seen and expected.
    pub fn check(&self) -> Vec<(String, String)> {
        let found = self.settings().check().into_iter();
        found.map(|(field, message)| (format!("{}.{field}", self.name()), message)).collect()
    }

    /// The environment, before its first episode.
    ///
    /// # Errors
    /// As [`EnvConfig::build_several`].
    pub fn build(&self) -> Result<Box<dyn Env>, EnvError> {
        self.build_several(1, 1)?.pop().ok_or(EnvError::NotStarted)
    }

    /// As [`EnvSettings::build`], after the settings were checked.
    ///
    /// # Errors
    /// The first problem that [`EnvConfig::check`] finds; a missing program or package.
    pub fn build_several(&self, count: usize, workers: usize) -> Result<Vec<Box<dyn Env>>, EnvError> {
        if let Some((field, message)) = self.check().into_iter().next() {
            return Err(EnvError::Config { field, message });
        }
        self.settings().build(count, workers)
    }

    /// See [`EnvSettings::known_spaces`].
    pub fn known_spaces(&self) -> Option<(ObservationSpace, ActionSpace)> {
        self.settings().known_spaces()
    }

    /// See [`EnvSettings::spaces`].
    ///
    /// # Errors
    /// As [`EnvSettings::spaces`].
    pub fn spaces(&self) -> Result<(ObservationSpace, ActionSpace), EnvError> {
        self.settings().spaces()
    }

    /// See [`EnvSettings::action_labels`].
    pub fn action_labels(&self) -> &'static [&'static str] {
        self.settings().action_labels()
    }

    /// See [`EnvSettings::steps_per_second`].
    pub fn steps_per_second(&self) -> f64 {
        self.settings().steps_per_second()
    }

    /// See [`EnvSettings::aspect_ratio`].
    pub fn aspect_ratio(&self) -> f64 {
        self.settings().aspect_ratio()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::car_racing::CarRacingVersion;

    #[test]
    fn every_field_has_a_default() {
        let config: EnvConfig = serde_json::from_str(r#"{"car-racing": {}}"#).unwrap();
        assert_eq!(config, EnvConfig::default());
        assert!(config.check().is_empty());
    }

    #[test]
    fn the_canonical_settings_stay_the_same_for_ever() {
        // They are part of every key. A change here makes all cached results stale.
        let car = |version, lap_complete_percent| {
            EnvConfig::CarRacing(CarRacingConfig { version, lap_complete_percent, ..Default::default() })
        };
        for (config, canonical) in [
            (EnvConfig::default(), r#"{"car-racing":{"version":"v0","time_limit":1000}}"#),
            (
                car(CarRacingVersion::V3, Some(0.95)),
                r#"{"car-racing":{"version":"v3","time_limit":1000,"lap_complete_percent":0.95}}"#,
            ),
            (EnvConfig::LunarLander(LunarLanderConfig::default()), r#"{"lunar-lander":{"time_limit":1000}}"#),
        ] {
            assert_eq!(serde_json::to_string(&config).unwrap(), canonical);
            assert_eq!(serde_json::from_str::<EnvConfig>(canonical).unwrap(), config);
        }
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
        let config = EnvConfig::LunarLander(LunarLanderConfig { time_limit: 0 });
        assert_eq!(config.check()[0].0, "lunar-lander.time_limit");
    }
}
