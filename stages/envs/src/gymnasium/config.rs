//! `env: { gymnasium: ... }` of the pipeline file: an id alone, or a map of settings.

use std::collections::BTreeMap;
use std::fmt;

use schemars::JsonSchema;
use serde::de::value::MapAccessDeserializer;
use serde::de::{MapAccess, Visitor};
use serde::{Deserialize, Deserializer, Serialize};
use serde_json::Value;

use super::venv::REQUIREMENTS;

/// The bridge's revision; raised when `worker.py` or the preprocessing changes a result.
const BRIDGE: u32 = 1;
/// The packages whose versions can change a result.
const PLAYING: [&str; 5] = ["ale-py", "box2d", "gymnasium", "numpy", "pygame-ce"];
/// Arguments of `gymnasium.make` that have their own setting, or none.
const TAKEN: [(&str, &str); 3] = [
    ("id", "write `id` beside `kwargs`"),
    ("max_episode_steps", "write `time_limit` beside `kwargs`"),
    ("render_mode", "leave it out: images are rendered when needed"),
];

/// Settings of an environment of Gymnasium or the Arcade Learning Environment. `gymnasium: CarRacing-v3` is short for
/// `gymnasium: { id: CarRacing-v3 }`.
#[derive(Clone, Debug, PartialEq, Serialize, JsonSchema)]
pub struct GymnasiumConfig {
    /// The id, as for `gymnasium.make`: `CarRacing-v3`, `LunarLanderContinuous-v3`, `ALE/Breakout-v5`.
    pub id: String,
    /// Steps after which an episode is truncated. Default: as registered in Gymnasium; 27,000 for Atari.
    #[serde(skip_serializing_if = "Option::is_none")]
    #[schemars(default)]
    pub time_limit: Option<u32>,
    /// Further arguments of `gymnasium.make`, such as `lap_complete_percent` of CarRacing. For Atari, those of
    /// `AtariVectorEnv`: `reward_clipping`, `episodic_life`, `noop_max`, ...
    #[serde(skip_serializing_if = "BTreeMap::is_empty")]
    #[schemars(default)]
    pub kwargs: BTreeMap<String, Value>,
    /// Which track a seed gives in CarRacing.
    #[serde(skip_serializing_if = "Tracks::are_gymnasium")]
    #[schemars(default)]
    pub tracks: Tracks,
    /// The bridge's revision and the versions of the packages. Filled in automatically, so that results of other versions
    /// are not reused; leave it out.
    #[schemars(default = "versions")]
    pub versions: String,
}

/// Which track a seed gives in Gymnasium's CarRacing.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "kebab-case")]
pub enum Tracks {
    /// The track that Gymnasium generates.
    #[default]
    Gymnasium,
    /// The track that `car-racing` generates: its random draws are passed to Gymnasium.
    CarRacing,
}

impl Tracks {
    fn are_gymnasium(&self) -> bool {
        *self == Self::Gymnasium
    }
}

/// The versions of this program's bridge and packages, as one string.
pub fn versions() -> String {
    let packages = playing().map(|(name, version)| format!(", {name} {version}"));
    format!("bridge {BRIDGE}{}", packages.collect::<String>())
}

/// Name and version of every package that can change a result.
pub(super) fn playing() -> impl Iterator<Item = (&'static str, &'static str)> {
    let all = REQUIREMENTS.lines().filter_map(|line| line.trim().split_once("=="));
    all.filter(|(name, _)| PLAYING.contains(name))
}

impl GymnasiumConfig {
    /// The environment with this id and Gymnasium's default settings.
    pub fn new(id: &str) -> Self {
        Self {
            id: id.to_owned(),
            time_limit: None,
            kwargs: BTreeMap::new(),
            tracks: Tracks::default(),
            versions: versions(),
        }
    }

    /// Every field that is invalid independent of Gymnasium: its name, and what was seen and expected.
    pub(crate) fn check(&self) -> Vec<(String, String)> {
        let mut found = Vec::new();
        let mut add = |field: &str, message: String| found.push((field.to_owned(), message));
        let is_id = |c: char| c.is_ascii_alphanumeric() || "-_./:".contains(c);
        if self.id.is_empty() || !self.id.chars().all(is_id) {
            let message = format!("`{}`, expected an id of Gymnasium, such as `CarRacing-v3`", self.id);
            add("id", message);
        }
        if self.time_limit == Some(0) {
            add("time_limit", "0 steps, expected at least 1".into());
        }
        for (name, fix) in TAKEN.iter().filter(|(name, _)| self.kwargs.contains_key(*name)) {
            add(&format!("kwargs.{name}"), format!("`{name}` is not a setting here: {fix}"));
        }
        if self.tracks == Tracks::CarRacing && !self.is_car() {
            add("tracks", format!("`car-racing`, but only CarRacing has tracks, and this is `{}`", self.id));
        }
        if self.versions != versions() {
            let message =
                format!("`{}`, but this program uses `{}`; leave the field out", self.versions, versions());
            add("versions", message);
        }
        found
    }

    /// True for every version of CarRacing.
    pub(super) fn is_car(&self) -> bool {
        self.id.starts_with("CarRacing-")
    }
}

impl<'de> Deserialize<'de> for GymnasiumConfig {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        deserializer.deserialize_any(IdOrSettings)
    }
}

struct IdOrSettings;

/// The fields of the long form.
#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct Fields {
    id: String,
    #[serde(default)]
    time_limit: Option<u32>,
    #[serde(default)]
    kwargs: BTreeMap<String, Value>,
    #[serde(default)]
    tracks: Tracks,
    #[serde(default = "versions")]
    versions: String,
}

impl<'de> Visitor<'de> for IdOrSettings {
    type Value = GymnasiumConfig;

    fn expecting(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str("an id of Gymnasium, such as `CarRacing-v3`, or a map with `id`")
    }

    fn visit_str<E: serde::de::Error>(self, id: &str) -> Result<GymnasiumConfig, E> {
        Ok(GymnasiumConfig::new(id))
    }

    fn visit_map<A: MapAccess<'de>>(self, map: A) -> Result<GymnasiumConfig, A::Error> {
        let Fields { id, time_limit, kwargs, tracks, versions } =
            Fields::deserialize(MapAccessDeserializer::new(map))?;
        Ok(GymnasiumConfig { id, time_limit, kwargs, tracks, versions })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::EnvConfig;
    use serde_json::json;

    fn read(value: Value) -> Result<EnvConfig, serde_json::Error> {
        serde_json::from_value(value)
    }

    #[test]
    fn an_id_alone_is_the_short_form() {
        let short = read(json!({ "gymnasium": "ALE/Breakout-v5" })).unwrap();
        assert_eq!(short, read(json!({ "gymnasium": { "id": "ALE/Breakout-v5" } })).unwrap());
        assert_eq!(short, EnvConfig::Gymnasium(GymnasiumConfig::new("ALE/Breakout-v5")));
        assert!(short.check().is_empty());
    }

    #[test]
    fn what_is_written_back_has_the_versions_and_reads_the_same() {
        let full = json!({ "gymnasium": {
            "id": "CarRacing-v3", "time_limit": 20, "kwargs": { "lap_complete_percent": 1.0 }, "tracks": "car-racing"
        }});
        let config = read(full.clone()).unwrap();
        assert!(config.check().is_empty());
        let written = serde_json::to_value(&config).unwrap();
        let mut wanted = full;
        wanted["gymnasium"]["versions"] = versions().into();
        assert_eq!(written, wanted);
        assert_eq!(read(written).unwrap(), config);
        // A new version here makes all results of the bridge new: that is what the text is for.
        assert_eq!(
            versions(),
            "bridge 1, ale-py 0.12.1, box2d 2.3.10, gymnasium 1.4.0, numpy 2.4.6, pygame-ce 2.5.8"
        );
    }

    #[test]
    fn every_mistake_is_told_with_its_place() {
        let config = read(json!({ "gymnasium": {
            "id": "Pong v5", "time_limit": 0, "kwargs": { "render_mode": "human" }, "tracks": "car-racing", "versions": "x"
        }}));
        let fields: Vec<String> = config.unwrap().check().into_iter().map(|(field, _)| field).collect();
        assert_eq!(
            fields,
            ["id", "time_limit", "kwargs.render_mode", "tracks", "versions"]
                .map(|field| format!("gymnasium.{field}"))
        );
        let error = read(json!({ "gymnasium": { "id": "CarRacing-v3", "timelimit": 3 } })).unwrap_err();
        assert!(error.to_string().contains("unknown field `timelimit`"), "{error}");
        let error = read(json!({ "gymnasium": 3 })).unwrap_err();
        assert!(error.to_string().contains("an id of Gymnasium"), "{error}");
    }
}
