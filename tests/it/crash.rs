//! Killed at any moment, the next run goes on.
