//! Training data: demonstrations, their split, and frames.

pub mod dataset;
pub mod frames;
pub mod split;
pub mod transitions;
