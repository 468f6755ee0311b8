//! Small stage kinds for tests of the engine.
