//! What every learning stage does first: the process is set up, and the result's fingerprint recorded.

use std::marker::PhantomData;
use std::sync::Once;

use dril_stage_api::{Ctx, Describe, Stage, StageError};

use crate::fingerprint;

/// The stage `S` in a process that is set up for learning.
#[derive(Clone, Copy, Debug)]
pub struct Prepared<S>(PhantomData<S>);

impl<S: Stage> Stage for Prepared<S> {
    type Kind = S::Kind;

    fn run(params: &<S::Kind as Describe>::Params, ctx: &mut Ctx<'_>) -> Result<(), StageError> {
        prepare();
        fingerprint::record(ctx);
        S::run(params, ctx)
    }
}

/// Sets the process up: the allocator keeps freed memory, and libtorch computes on one thread.
///
/// Two stages side by side lose no throughput against one stage on two threads, and results must not depend on how many
/// cores a machine has.
pub fn prepare() {
    static ONCE: Once = Once::new();
    ONCE.call_once(|| {
        keep_freed_memory();
        // Torch refuses to be asked twice.
        tch::set_num_interop_threads(1);
    });
    // OpenMP keeps this number per thread, so a second thread has to set it as well.
    tch::set_num_threads(1);
}

/// Tells glibc to keep freed memory instead of returning it to the system.
///
/// A training step frees some megabytes of observations and gradients; by default each such block is unmapped, and the
/// next step pays for new pages.
fn keep_freed_memory() {
    #[cfg(all(target_os = "linux", target_env = "gnu"))]
    #[allow(unsafe_code)]
    // SAFETY: `mallopt` only sets three numbers in the allocator and may be called at any time.
    unsafe {
        libc::mallopt(libc::M_MMAP_THRESHOLD, 1 << 30);
        libc::mallopt(libc::M_TRIM_THRESHOLD, i32::MAX);
        libc::mallopt(libc::M_TOP_PAD, 64 << 20);
    }
}
