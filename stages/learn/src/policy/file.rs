//! A policy as a file.

use std::path::Path;

use dril_stage_api::StageError;
use serde::{Deserialize, Serialize};

use super::{Architecture, Policy};
use crate::net::{Observation, weights};
use crate::normalize::ObservationStatistics;

/// What stands in the file's metadata.
#[derive(Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct About {
    /// Tells policies from ensembles, and this layout from later ones.
    format: String,
    architecture: Architecture,
    /// What observations are scaled by; left out where they are not.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    statistics: Option<ObservationStatistics>,
}

const FORMAT: &str = "policy-v1";

impl Policy {
    /// The bytes of its file.
    ///
    /// # Errors
    /// None that is known of.
    pub fn to_bytes(&self) -> Result<Vec<u8>, StageError> {
        let (architecture, statistics) = (self.architecture(), self.statistics.clone());
        let about = About { format: FORMAT.to_owned(), architecture, statistics };
        weights::to_bytes(&about, &self.params)
    }

    /// Writes its file.
    ///
    /// # Errors
    /// The file cannot be written.
    pub fn save(&self, path: &Path) -> Result<(), StageError> {
        std::fs::write(path, self.to_bytes()?).map_err(StageError::io("cannot write", path))
    }

    /// Reads the policy at the input `port`.
    ///
    /// # Errors
    /// The file cannot be read or holds no policy; the message says what was seen and expected.
    pub fn load(port: &str, path: &Path) -> Result<Self, StageError> {
        let file = weights::read(port, path)?;
        let about: About = file.about(port, path)?;
        if about.format != FORMAT {
            let message = format!("has the format `{}`, expected `{FORMAT}`", about.format);
            return Err(StageError::input(port, path, message));
        }
        let mut policy = Self::build(about.architecture, None)?;
        file.fill(port, path, &mut policy.params)?;
        let fits = |statistics: &ObservationStatistics| {
            let seen = Observation::Vector { len: statistics.len() };
            statistics.is_sound() && seen == about.architecture.observation
        };
        if about.statistics.as_ref().is_some_and(|statistics| !fits(statistics)) {
            let message = "its observation statistics do not fit its observations; train it again";
            return Err(StageError::input(port, path, message));
        }
        policy.statistics = about.statistics;
        Ok(policy)
    }
}
