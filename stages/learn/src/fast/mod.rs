//! The one room for speed: each trick stands here with its reason and what it gained; networks and losses stay plain.
//!
//! - [`prepare`]: one thread for torch, and an allocator that keeps what it has.
//! - [`memory`]: tensors as plain slices.
//! - [`layout`]: the first convolution over blocks of 4×4 pixels, by libtorch.
//!
//! The arithmetic of the layers is in [`crate::kernels`].

pub mod layout;
pub mod memory;

use std::sync::Once;

/// To be called first by every stage that computes with torch, on the thread that computes.
///
/// One thread: bits differ between one and two, and two stages side by side lose no throughput against one stage on two
/// threads. Never the machine's core count, so that results do not depend on it.
pub fn prepare() {
    static ONCE: Once = Once::new();
    ONCE.call_once(|| {
        memory::keep_freed_memory();
        // Torch refuses to be told twice.
        tch::set_num_interop_threads(1);
    });
    // OpenMP keeps this number per thread, so a second thread has to be told as well.
    tch::set_num_threads(1);
}
