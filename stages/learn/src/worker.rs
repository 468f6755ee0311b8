//! Set-up of the worker process, which every learning stage needs before it runs.

use std::marker::PhantomData;
use std::sync::Once;

use dril_stage_api::{Ctx, Describe, Stage, StageError};

use crate::fingerprint;

/// The stage `S`, run after the process was set up and the fingerprint of its result recorded.
#[derive(Clone, Copy, Debug)]
pub struct InWorker<S>(PhantomData<S>);

impl<S: Stage> Stage for InWorker<S> {
    type Kind = S::Kind;

    fn run(params: &<S::Kind as Describe>::Params, ctx: &mut Ctx<'_>) -> Result<(), StageError> {
        prepare();
        fingerprint::record(ctx);
        S::run(params, ctx)
    }
}

/// Sets up the process: the allocator keeps freed memory, and libtorch uses one thread.
///
/// Two stages in parallel have the throughput of one stage on two threads, and results must not depend on the number of
/// cores.
pub fn prepare() {
    static ONCE: Once = Once::new();
    ONCE.call_once(|| {
        keep_freed_memory();
        // libtorch allows this call only once.
        tch::set_num_interop_threads(1);
    });
    // OpenMP stores this number per thread, so every thread has to set it.
    tch::set_num_threads(1);
}

/// Makes glibc keep freed memory instead of returning it to the system.
///
/// A training step frees some megabytes of observations and gradients; by default, each block is unmapped, and the next
/// step faults in new pages.
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
