//! The arithmetic of the networks: layers, their gradients and the optimizer's step, over plain slices.
//!
//! - [`conv`], [`dense`]: layers and their gradients; [`activation`]: what follows a layer; [`adam`]: the optimizer's
//!   inner loop; [`layout`]: frames in blocks of 4×4 pixels, transposition.
//! - `vector`: explicit vectors of 16 numbers for AVX-512, for AVX2 with FMA, and without either; `tile`: the one loop
//!   in which nearly all time is spent, the products of a small block that is held in registers.
//!
//! **Bits.** Every number is computed by one sequence of correctly rounded operations, which is documented at each
//! function and depends on the shape of the layer alone: neither on the instruction set, nor on how work is cut into
//! blocks, nor on the other rows of a batch. So all [`paths`] give the same bits.
//!
//! Why these kernels and not a library's: docs/design/kernels.md.

#![allow(
    clippy::needless_range_loop,
    reason = "the rows and columns of a block are numbered; loops over constants are unrolled whole"
)]

pub mod activation;
pub mod adam;
mod buffer;
pub mod conv;
pub mod dense;
pub mod layout;
mod tile;
mod vector;

#[cfg(test)]
mod tests;

pub use buffer::Buffer;
pub use vector::{LANES, Path, forced, path, paths};
