//! What stands between an environment and a policy: [`preprocess`] makes the thesis's observation from an image,
//! [`FrameStack`] adds the history, [`VecEnv`] steps several environments at once.

mod frame_stack;
pub mod preprocess;
mod vec_env;

pub use frame_stack::FrameStack;
pub use vec_env::{FinishedEpisode, VecEnv, VecEnvSlotSnapshot, VecEnvSnapshot, VecStep};
