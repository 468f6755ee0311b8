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

/// What actions are, as far as learning goes.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Actions {
    /// So many numbers.
    Numbers(usize),
    /// One of so many choices.
    Choices(usize),
}

impl Actions {
    /// Those of an environment.
    pub fn of(space: &ActionSpace) -> Self {
        match *space {
            ActionSpace::Continuous { dims } => Self::Numbers(dims),
            ActionSpace::Discrete { actions } => Self::Choices(actions),
        }
    }

    /// How many values a network answers with: one for each number, or for each choice.
    pub fn count(self) -> usize {
        match self {
            Self::Numbers(count) | Self::Choices(count) => count,
        }
    }

    /// Checks that a policy family gives such actions.
    ///
    /// # Errors
    /// It does not; the message says which do.
    pub fn check(self, family: PolicyFamily) -> Result<(), StageError> {
        let (seen, mend) = match (self, family == PolicyFamily::Categorical) {
            (Self::Numbers(_), false) | (Self::Choices(_), true) => return Ok(()),
            (Self::Numbers(count), true) => (format!("{count} numbers"), "`gaussian` or `beta`"),
            (Self::Choices(count), false) => (format!("one of {count} choices"), "`categorical`"),
        };
        Err(StageError::failed(format!("an action is {seen} here; set `policy` to {mend}")))
    }
}

impl std::fmt::Display for Actions {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        match self {
            Self::Numbers(count) => write!(f, "actions of {count} numbers"),
            Self::Choices(count) => write!(f, "one of {count} choices"),
        }
    }
}

/// What an agent in this environment sees and does.
///
/// # Errors
/// It has to be looked up, and cannot be.
pub fn of(env: &EnvConfig) -> Result<(Observation, Actions), StageError> {
    let (space, action) = env.spaces().map_err(StageError::failed)?;
    Ok((observation(&space), Actions::of(&action)))
}

/// The architecture of an agent for this environment; `network` left out means `images` for environments that show
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
    actions.check(family)?;
    let network = network.unwrap_or(match observation {
        Observation::Images { .. } => images,
        Observation::Vector { .. } => Network::Mlp,
    });
    Ok(Architecture { network, family, observation, actions: actions.count() })
}

/// Checks that the policy knows what the environment shows and takes.
///
/// # Errors
/// It was made for another environment; the message shows both.
pub fn check(policy: &Policy, env: &EnvConfig) -> Result<(), StageError> {
    let seen = (policy.architecture().observation, policy.architecture().gives());
    let wanted = of(env)?;
    if seen == wanted {
        return Ok(());
    }
    Err(StageError::failed(format!(
        "the policy sees {:?} and gives {}, but `env` shows {:?} and takes {}; give `env` the environment that the policy \
         was trained in",
        seen.0, seen.1, wanted.0, wanted.1
    )))
}
