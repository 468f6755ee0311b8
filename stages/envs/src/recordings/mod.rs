//! Episodes on disk: [`Demonstrations`] to learn from, and [`video`]s to look at.

mod demonstrations;
pub mod video;

pub use demonstrations::{ActionRange, Demonstrations, DemosError, DemosHeader, Episode};
