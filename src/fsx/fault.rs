//! Dies at a chosen point of writing, so that tests can kill the engine between any two steps that touch the disk.
//! In release builds the points are empty.

#[cfg(debug_assertions)]
mod armed {
    use std::sync::atomic::{AtomicU64, Ordering};

    /// Points still to pass; 0 is "not armed".
    static LEFT: AtomicU64 = AtomicU64::new(0);

    /// Kills this process, as `kill -9` would, when it comes to the `nth` point (from 1).
    pub fn arm(nth: u64) {
        LEFT.store(nth, Ordering::SeqCst);
    }

    pub(in crate::fsx) fn point() {
        let counted = LEFT.fetch_update(Ordering::SeqCst, Ordering::SeqCst, |left| left.checked_sub(1));
        if counted == Ok(1) {
            let _ = rustix::process::kill_process(rustix::process::getpid(), rustix::process::Signal::KILL);
            std::process::abort();
        }
    }
}

#[cfg(debug_assertions)]
pub use armed::arm;
#[cfg(debug_assertions)]
pub(super) use armed::point;

/// A step that touches the disk.
#[cfg(not(debug_assertions))]
#[inline(always)]
pub(super) fn point() {}
