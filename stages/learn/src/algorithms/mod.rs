//! The learning algorithms, one file for each with its whole idea in view.
//!
//! - [`ppo`]: advantages, the clipped loss and the minibatch loop; [`on_policy`]: the loop of rollouts and updates around
//!   it, with hooks; [`ppo_stage`]: the stage that trains experts.
//! - [`dril`]: what DRIL adds to that loop.
//! - [`imitation`]: supervised learning of demonstrated actions; [`bc`] and [`ensemble`]: the networks that do it.

pub mod bc;
pub mod dril;
pub mod ensemble;
pub mod imitation;
pub mod on_policy;
pub mod ppo;
pub mod ppo_stage;
