//! All tests that run the engine from the outside, in one binary. Lower-level tests stand beside the code.

mod cache;
mod cli;
mod crash;
mod exec_order;
mod fakes;
mod parse;
mod plan;
mod prop;
mod resolve;
mod scenario;
mod tidy;
