//! The threads of this machine, for stages that run beside the engine.

use std::sync::{Condvar, Mutex, PoisonError};

/// Threads that stages share.
pub(super) struct Threads {
    all: usize,
    free: Mutex<usize>,
    freed: Condvar,
}

impl Threads {
    /// All that there are.
    pub fn of_this_machine() -> Self {
        let all = std::thread::available_parallelism().map_or(1, usize::from);
        Self { all, free: Mutex::new(all), freed: Condvar::new() }
    }

    /// Waits until so many are free; a stage that wants more than there are gets all.
    pub fn take(&self, wanted: usize) -> Taken<'_> {
        let wanted = wanted.clamp(1, self.all);
        let free = self.free.lock().unwrap_or_else(PoisonError::into_inner);
        let mut free =
            self.freed.wait_while(free, |free| *free < wanted).unwrap_or_else(PoisonError::into_inner);
        *free -= wanted;
        Taken { threads: self, count: wanted }
    }
}

/// Threads that a stage keeps until this is dropped.
pub(super) struct Taken<'a> {
    threads: &'a Threads,
    count: usize,
}

impl Drop for Taken<'_> {
    fn drop(&mut self) {
        *self.threads.free.lock().unwrap_or_else(PoisonError::into_inner) += self.count;
        self.threads.freed.notify_all();
    }
}
