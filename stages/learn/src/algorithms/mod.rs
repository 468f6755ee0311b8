//! The learning algorithms, one file each.
//!
//! - [`ppo`]: advantages, the clipped loss and the minibatch loop; [`on_policy`]: the loop of rollouts and updates, with
//!   hooks; [`ppo_stage`]: the stage `ppo`.
//! - [`dril`]: the hooks of DRIL.
//! - [`imitation`]: supervised learning of demonstrated actions, the training loop of [`bc`] and [`ensemble`].

pub mod bc;
pub mod dril;
pub mod ensemble;
pub mod imitation;
pub mod on_policy;
pub mod ppo;
pub mod ppo_stage;
