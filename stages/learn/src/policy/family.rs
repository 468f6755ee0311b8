//! Which policy families match which action spaces.

use dril_envs::ActionSpace;
use dril_kinds::PolicyFamily;
use dril_stage_api::StageError;

/// Checks that a policy family has this kind of actions.
///
/// # Errors
/// It does not; the message names those that do.
pub fn check_family(space: ActionSpace, family: PolicyFamily) -> Result<(), StageError> {
    let (seen, remedy) = match (space, family == PolicyFamily::Categorical) {
        (ActionSpace::Continuous { .. }, false) | (ActionSpace::Discrete { .. }, true) => return Ok(()),
        (ActionSpace::Continuous { dims }, true) => {
            (format!("{dims} continuous actions"), "`gaussian` or `beta`")
        }
        (ActionSpace::Discrete { actions }, false) => {
            (format!("{actions} discrete actions"), "`categorical`")
        }
    };
    Err(StageError::failed(format!("the environment has {seen}; set `policy` to {remedy}")))
}
