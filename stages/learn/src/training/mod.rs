//! The parts that trainings share: rollouts, running statistics, logs and checkpoints.

pub mod checkpoint;
pub mod episodes;
pub mod log;
pub mod normalize;
pub mod rollout;
pub mod tensorboard;
