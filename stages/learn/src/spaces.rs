//! From an environment's spaces to an agent's architecture.

use dril_envs::{ActionSpace, EnvConfig, ObservationSpace};
use dril_kinds::{Network, PolicyFamily};
use dril_stage_api::StageError;

use crate::policy::{Architecture, Policy};

/// An action space in words.
pub fn describe(space: ActionSpace) -> String {
    match space {
        ActionSpace::Continuous { dims } => format!("actions of {dims} numbers"),
        ActionSpace::Discrete { actions } => format!("one of {actions} choices"),
    }
}

/// Checks that a policy family gives such actions.
///
/// # Errors
/// It does not; the message names the families that do.
pub fn check_family(space: ActionSpace, family: PolicyFamily) -> Result<(), StageError> {
    let (seen, remedy) = match (space, family == PolicyFamily::Categorical) {
        (ActionSpace::Continuous { .. }, false) | (ActionSpace::Discrete { .. }, true) => return Ok(()),
        (ActionSpace::Continuous { dims }, true) => (format!("{dims} numbers"), "`gaussian` or `beta`"),
        (ActionSpace::Discrete { actions }, false) => (format!("one of {actions} choices"), "`categorical`"),
    };
    Err(StageError::failed(format!("an action is {seen} here; set `policy` to {remedy}")))
}

/// What an environment shows and takes.
///
/// # Errors
/// It has to be started to find out, and that fails.
pub fn of(env: &EnvConfig) -> Result<(ObservationSpace, ActionSpace), StageError> {
    env.spaces().map_err(StageError::failed)
}

/// The architecture of an agent for this environment. Without a `network` it is `images` for environments that show
/// images and [`Network::Mlp`] for the others.
///
/// # Errors
/// The family does not give the environment's actions, or as [`of`].
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

/// Checks that the policy takes what the environment shows and gives the actions that it takes.
///
/// # Errors
/// It was made for another environment; the message shows both.
pub fn check(policy: &Policy, env: &EnvConfig) -> Result<(), StageError> {
    let Architecture { observation, actions, .. } = policy.architecture();
    let wanted = of(env)?;
    if (observation, actions) == wanted {
        return Ok(());
    }
    Err(StageError::failed(format!(
        "the policy sees {observation:?} and gives {}, but `env` shows {:?} and takes {}; give `env` the environment that \
         the policy was trained in",
        describe(actions),
        wanted.0,
        describe(wanted.1)
    )))
}
