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
        check(&processor())?;
        prepare();
        fingerprint::record(ctx);
        S::run(params, ctx)
    }
}

/// The features of the processor that results are promised with, and whether it has them.
#[cfg(target_arch = "x86_64")]
fn processor() -> [(&'static str, bool); 2] {
    [("AVX2", is_x86_feature_detected!("avx2")), ("FMA", is_x86_feature_detected!("fma"))]
}

#[cfg(not(target_arch = "x86_64"))]
fn processor() -> [(&'static str, bool); 0] {
    []
}

/// Without these instructions a training of an hour takes days, so it is an error before it begins.
fn check(features: &[(&str, bool)]) -> Result<(), StageError> {
    let lacking: Vec<&str> = features.iter().filter(|(_, there)| !there).map(|(name, _)| *name).collect();
    if lacking.is_empty() {
        return Ok(());
    }
    Err(StageError::failed(format!(
        "this processor has no {}, which learning stages need: use another machine; on a cluster, exclude such nodes, as \
         with `extra = [\"--constraint=avx2\"]` in `dril-pipe.toml`",
        lacking.join(" and no ")
    )))
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

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_processor_without_avx2_is_an_error_that_says_what_to_do() {
        assert!(check(&[("AVX2", true), ("FMA", true)]).is_ok());
        let error = check(&[("AVX2", false), ("FMA", false)]).unwrap_err().to_string();
        assert!(
            error.starts_with("this processor has no AVX2 and no FMA, which learning stages need"),
            "{error}"
        );
        assert!(error.contains("--constraint=avx2"), "{error}");
    }
}
