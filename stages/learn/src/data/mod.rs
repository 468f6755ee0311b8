//! Demonstrations and frames as algorithms read them.

pub mod dataset;
pub mod frames;
pub mod pairs;
pub mod split;
