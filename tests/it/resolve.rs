//! From a pipeline file to its stage instances.
