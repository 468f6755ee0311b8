//! Kernels: the arithmetic of layers, their gradients and the optimizer's step, on plain slices.
//!
//! - [`conv`], [`dense`]: layers and their gradients; [`activation`]: activation functions; [`optimizer`]: the optimizer's
//!   inner loop; [`layout`]: frames in blocks of 4×4 pixels, transposition.
//! - `vector`: explicit SIMD vectors of 16 numbers for AVX-512, for AVX2 with FMA, and portable; `tile`: the loop in which
//!   nearly all time is spent, sums of products for a small block held in registers.
//!
//! **Bits.** Every number is computed by one sequence of correctly rounded operations, which is documented at each
//! function and depends only on the shape of the layer, not on the instruction set, the division into blocks, or
//! the other rows of a batch. So all [`paths`] give the same bits.
//!
//! docs/design/kernels.md explains why these are not a library's.

#![allow(
    clippy::needless_range_loop,
    reason = "the rows and columns of a block are numbered; loops over constants are unrolled whole"
)]

pub mod activation;
mod buffer;
pub mod conv;
pub mod dense;
pub mod layout;
pub mod optimizer;
mod tile;
mod vector;

#[cfg(test)]
mod tests;

pub use buffer::Buffer;
pub use vector::{LANES, Path, forced, path, paths};
