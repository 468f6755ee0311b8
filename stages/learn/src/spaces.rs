//! From an environment's spaces to an agent's architecture.

use dril_envs::{ActionSpace, EnvConfig, ObservationSpace};
use dril_stage_api::StageError;

use crate::net::{Network, Observation};
use crate::policy::{Architecture, Policy, PolicyFamily};

/// What an agent sees where an environment shows this.
pub fn observation(space: &ObservationSpace) -> Observation {
    match *space {
        ObservationSpace::Image { height, width, stack } => Observation::Images { height, width, stack },
        ObservationSpace::Vector { len } => Observation::Vector { len },
    }
}

/// What an agent in this environment sees, and how many action dimensions it has.
///
/// # Errors
/// The environment takes one of several choices: there is no policy family for that yet.
pub fn of(env: &EnvConfig) -> Result<(Observation, usize), StageError> {
    let (space, action) = env.spaces();
    let observation = observation(&space);
    match action {
        ActionSpace::Continuous { dims } => Ok((observation, dims)),
        ActionSpace::Discrete { actions } => Err(StageError::failed(format!(
            "the environment takes one of {actions} choices, expected one with continuous actions"
        ))),
    }
}

/// The architecture of an agent for this environment; `network` left out means `images` for environments that show
/// images and [`Network::Mlp`] for the others.
///
/// # Errors
/// As [`of`].
pub fn architecture(
    env: &EnvConfig,
    family: PolicyFamily,
    network: Option<Network>,
    images: Network,
) -> Result<Architecture, StageError> {
    let (observation, actions) = of(env)?;
    let network = network.unwrap_or(match observation {
        Observation::Images { .. } => images,
        Observation::Vector { .. } => Network::Mlp,
    });
    Ok(Architecture { network, family, observation, actions })
}

/// Checks that the policy knows what the environment shows and takes.
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
        "the policy sees {observation:?} and gives {actions} actions, but `env` shows {:?} and takes {}; give `env` the \
         environment that the policy was trained in",
        wanted.0, wanted.1
    )))
}
