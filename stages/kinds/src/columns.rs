//! The columns of the CSV files that trainings write. They are declared here, and not where they are written, so that a figure
//! that names another column is an error before the training.

/// The columns of the output `episodes` of `ppo` and `dril`: one row per finished episode, in the order in which they finish (in the
/// order of the environments where several finish at the same step):
///
/// - `episode`: its number, from 0;
/// - `step`: environment steps over all environments when it ended, counted from the start of the whole training;
/// - `update`: updates before it ended, counted in the same way;
/// - `seed`: its environment seed, which determines its track, terrain or level;
/// - `score`: the sum of the environment's own rewards;
/// - `length`: its steps;
/// - `u_signal`: the mean over its steps of the ensemble's reward (+1 or -1, before scaling); empty for `ppo`.
pub const EPISODE_COLUMNS: [&str; 7] = ["episode", "step", "update", "seed", "score", "length", "u_signal"];

/// The columns of the output `log` of `ppo` and `dril`, one row per update. `diverged` is 1 in the last row of a training that
/// stopped because its update diverged, else 0.
pub const UPDATE_COLUMNS: [&str; 14] = [
    "update",
    "step",
    "episodes",
    "score_last",
    "score_mean_10",
    "score_mean_100",
    "policy_loss",
    "value_loss",
    "entropy",
    "explained_variance",
    "clip_fraction",
    "approx_kl",
    "learning_rate",
    "diverged",
];

/// What `dril` adds to [`UPDATE_COLUMNS`]. The last three describe the highest moving average so far: before which update, its
/// value, and over how many episodes (fewer than `peak_window` while fewer have ended; empty while none has).
pub const DRIL_COLUMNS: [&str; 6] =
    ["u_signal", "disagreement", "bc_loss", "peak_update", "peak_score", "peak_episodes"];

/// The columns of the output `log` of `bc` and `ensemble`, one row per epoch. Losses are mean squared errors of clamped actions:
/// over the batches of the epoch, and over the held-out transitions after it.
pub const EPOCH_COLUMNS: [&str; 6] =
    ["epoch", "step", "train_loss", "val_loss", "best_val_loss", "learning_rate"];
