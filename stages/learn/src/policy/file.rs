//! The file format of policies: weights, with the architecture in the metadata.

use std::path::Path;

use dril_envs::{ActionSpace, ObservationSpace};
use dril_kinds::{Network, PolicyFamily};
use dril_stage_api::StageError;
use serde::{Deserialize, Serialize};

use super::{Architecture, Policy};
use crate::nn::weights;
use crate::training::normalize::ObservationStatistics;

/// The metadata of the file.
#[derive(Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct About {
    /// Distinguishes policies from ensembles, and this layout from later ones.
    format: String,
    architecture: ArchitectureV1,
    /// Observation statistics; left out if observations are not normalised.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    statistics: Option<ObservationStatistics>,
    /// The step at which training diverged, so that these are the last finite weights; left out otherwise.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    diverged_at_step: Option<u64>,
}

/// An architecture as `policy-v1` stores it.
#[derive(Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct ArchitectureV1 {
    network: Network,
    family: PolicyFamily,
    observation: ObservationV1,
    /// Action dimensions, or number of discrete actions.
    actions: usize,
}

/// An observation space as `policy-v1` and `ensemble-v1` store it.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case", deny_unknown_fields)]
pub(crate) enum ObservationV1 {
    Images { height: usize, width: usize, stack: usize },
    Vector { len: usize },
}

impl From<ObservationSpace> for ObservationV1 {
    fn from(space: ObservationSpace) -> Self {
        match space {
            ObservationSpace::Image { height, width, stack } => Self::Images { height, width, stack },
            ObservationSpace::Vector { len } => Self::Vector { len },
        }
    }
}

impl From<ObservationV1> for ObservationSpace {
    fn from(stored: ObservationV1) -> Self {
        match stored {
            ObservationV1::Images { height, width, stack } => Self::Image { height, width, stack },
            ObservationV1::Vector { len } => Self::Vector { len },
        }
    }
}

impl From<Architecture> for ArchitectureV1 {
    fn from(architecture: Architecture) -> Self {
        let Architecture { network, family, observation, actions } = architecture;
        Self { network, family, observation: observation.into(), actions: actions.outputs() }
    }
}

impl From<ArchitectureV1> for Architecture {
    fn from(stored: ArchitectureV1) -> Self {
        let ArchitectureV1 { network, family, observation, actions } = stored;
        let actions = match family {
            PolicyFamily::Gaussian | PolicyFamily::Beta => ActionSpace::Continuous { dims: actions },
            PolicyFamily::Categorical => ActionSpace::Discrete { actions },
        };
        Self { network, family, observation: observation.into(), actions }
    }
}

const FORMAT: &str = "policy-v1";

impl Policy {
    /// The policy as a file.
    ///
    /// # Errors
    /// The metadata cannot be serialised.
    pub fn to_bytes(&self) -> Result<Vec<u8>, StageError> {
        let about = About {
            format: FORMAT.to_owned(),
            architecture: self.architecture().into(),
            statistics: self.statistics.clone(),
            diverged_at_step: self.diverged_at_step,
        };
        weights::to_bytes(&about, self.params())
    }

    /// Writes the policy to a file.
    ///
    /// # Errors
    /// The file cannot be written.
    pub fn save(&self, path: &Path) -> Result<(), StageError> {
        std::fs::write(path, self.to_bytes()?).map_err(StageError::io("cannot write", path))
    }

    /// Reads the policy at the input `port`.
    ///
    /// # Errors
    /// The file cannot be read, or is not a policy.
    pub fn load(port: &str, path: &Path) -> Result<Self, StageError> {
        let file = weights::read(port, path)?;
        let about: About = file.about(port, path)?;
        if about.format != FORMAT {
            let message = format!("has the format `{}`, expected `{FORMAT}`", about.format);
            return Err(StageError::input(port, path, message));
        }
        let architecture = Architecture::from(about.architecture);
        let mut policy = Self::blank(architecture)?;
        file.fill(port, path, policy.params_mut())?;
        let fits = |statistics: &ObservationStatistics| {
            let seen = ObservationSpace::Vector { len: statistics.len() };
            statistics.is_sound() && seen == architecture.observation
        };
        if about.statistics.as_ref().is_some_and(|statistics| !fits(statistics)) {
            let message = "its observation statistics do not fit its observations; train it again";
            return Err(StageError::input(port, path, message));
        }
        policy.statistics = about.statistics;
        policy.diverged_at_step = about.diverged_at_step;
        Ok(policy)
    }
}
