//! All tests that run the engine from the outside, in one binary. Lower-level tests stand beside the code.

mod bad;
mod cache;
mod cli;
mod cli_texts;
mod crash;
mod exec_order;
mod fakes;
mod lab;
mod parse;
mod plan;
mod prop;
mod resolve;
mod results;
mod samples;
mod scenario;
mod sealed;
mod tidy;
