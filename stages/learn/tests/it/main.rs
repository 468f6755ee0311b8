//! The stages as a program runs them: the whole chain, equal bytes beside neighbours, and after kills.
#![allow(clippy::unwrap_used, reason = "a test's own functions may fail the test")]

mod chain;
mod everywhere;
mod kill;
mod registered;
mod same;
mod worlds;
