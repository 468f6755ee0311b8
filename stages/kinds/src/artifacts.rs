//! The artifact types of learning.

use dril_envs::DEMONSTRATIONS;
use dril_stage_api::Artifact;

/// The weights of an agent that can act (safetensors with its architecture in the metadata).
pub const POLICY: Artifact = Artifact::new("policy", "safetensors");
/// The weights of an ensemble of policies (safetensors).
pub const ENSEMBLE: Artifact = Artifact::new("ensemble", "safetensors");

/// All artifact types of learning, for [`dril_stage_api::artifact::register`].
pub const ARTIFACTS: [Artifact; 3] = [POLICY, DEMONSTRATIONS, ENSEMBLE];
