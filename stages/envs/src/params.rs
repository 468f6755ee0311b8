//! Checks of the parameters that stage kinds share which play episodes: the environment, its seeds, and how many
//! episodes are kept of how many attempts.

use dril_stage_api::Problems;

use crate::EnvConfig;

/// Reports every setting of the parameter `env` that is out of range.
pub fn check_env(env: &EnvConfig, problems: &mut Problems) {
    for (field, message) in env.check() {
        problems.add(&format!("env.{field}"), message);
    }
}

/// Reports a list of `count` seeds from `first_seed` on that does not fit into 64 bits.
pub fn check_seeds(first_seed: u64, count: u64, problems: &mut Problems) {
    if first_seed.checked_add(count).is_none() {
        let message = format!(
            "`first_seed` is {first_seed}, expected a smaller one: {count} seeds from there exceed 64 bits"
        );
        problems.add("first_seed", message);
    }
}

/// Reports a number of `episodes` to keep that is 0, or more than `max_attempts`.
pub fn check_attempts(episodes: u64, max_attempts: u64, problems: &mut Problems) {
    problems.positive("episodes", episodes);
    if max_attempts < episodes {
        let message =
            format!("`max_attempts` is {max_attempts}, expected at least the {episodes} `episodes` to keep");
        problems.add("max_attempts", message);
    }
}
