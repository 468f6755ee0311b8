//! The artifact type of recorded episodes.

use dril_stage_api::Artifact;

/// Recorded episodes: observations and the actions that an expert took.
pub const DEMONSTRATIONS: Artifact = Artifact::new("demonstrations", "bin");
