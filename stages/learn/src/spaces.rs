//! Matches policies with environments: from observation and action space to an architecture.

use dril_envs::{ActionSpace, EnvConfig, ObservationSpace};
use dril_kinds::{Network, PolicyFamily};
use dril_stage_api::StageError;

use crate::policy::{Architecture, Policy, check_family};

/// Describes an action space.
pub fn describe(space: ActionSpace) -> String {
    match space {
        ActionSpace::Continuous { dims } => format!("{dims} continuous actions"),
        ActionSpace::Discrete { actions } => format!("{actions} discrete actions"),
    }
}

/// Observation and action space of an environment.
///
/// # Errors
/// Another program has to be asked for them, and that fails.
pub fn of(env: &EnvConfig) -> Result<(ObservationSpace, ActionSpace), StageError> {
    env.spaces().map_err(StageError::failed)
}

/// The architecture of a policy for this environment. The default `network` is `images` for image observations and
/// [`Network::Mlp`] for vectors.
///
/// # Errors
/// The family does not match the action space, or as [`of`].
pub fn architecture(
    env: &EnvConfig,
    family: PolicyFamily,
    network: Option<Network>,
    images: Network,
) -> Result<Architecture, StageError> {
    let (observation, actions) = of(env)?;
    check_family(actions, family)?;
    let network = network.unwrap_or(match observation {
        ObservationSpace::Image { .. } => images,
        ObservationSpace::Vector { .. } => Network::Mlp,
    });
    Ok(Architecture { network, family, observation, actions })
}

/// Checks that observation and action space of policy and environment are equal.
///
/// # Errors
/// They differ; the message shows both.
pub fn check(policy: &Policy, env: &EnvConfig) -> Result<(), StageError> {
    let Architecture { observation, actions, .. } = policy.architecture();
    let wanted = of(env)?;
    if (observation, actions) == wanted {
        return Ok(());
    }
    Err(StageError::failed(format!(
        "the policy has observations {observation:?} and {}, but `env` has observations {:?} and {}; set `env` to the \
         environment that the policy was trained in",
        describe(actions),
        wanted.0,
        describe(wanted.1)
    )))
}
