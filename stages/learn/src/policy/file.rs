//! A policy as a file.

use std::path::Path;

use dril_stage_api::StageError;
use serde::{Deserialize, Serialize};

use super::{Architecture, Policy};
use crate::net::weights;

/// What stands in the file's metadata.
#[derive(Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct About {
    /// Tells policies from ensembles, and this layout from later ones.
    format: String,
    architecture: Architecture,
}

const FORMAT: &str = "policy-v1";

impl Policy {
    /// The bytes of its file.
    ///
    /// # Errors
    /// None that is known of.
    pub fn to_bytes(&self) -> Result<Vec<u8>, StageError> {
        let about = About { format: FORMAT.to_owned(), architecture: self.architecture() };
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
        Ok(policy)
    }
}
