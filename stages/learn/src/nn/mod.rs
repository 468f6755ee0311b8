//! Networks: layers, their parameters and gradients, and the two backends that compute them.
//!
//! - [`Graph`], [`Builder`]: what a network consists of; [`Network`]: the graph with its weights and a backend.
//! - `native` (kernels of this crate) and `torch` (libtorch): the backends.
//! - [`Parameters`], [`Gradients`]: flat buffers; [`Optimizer`]: Adam and RMSprop; [`weights`]: the file format.
//! - [`trunk`]: the thesis's networks.

mod batch;
mod builder;
mod convolution;
mod graph;
mod init;
mod layers;
mod native;
mod network;
#[cfg(test)]
mod network_tests;
mod optimizer;
#[cfg(test)]
mod optimizer_tests;
mod orthogonal;
mod params;
mod torch;
pub mod trunk;
pub mod weights;

pub use batch::Batch;
pub use builder::Builder;
pub use graph::{Graph, NodeId, Wanted};
pub use init::Init;
pub use layers::{Activation, LayerInit, Sequential};
pub use network::{Network, Tape};
pub use optimizer::{Optimizer, OptimizerSettings, norm};
pub use params::{Gradients, ParamId, ParamSpec, Parameters};
