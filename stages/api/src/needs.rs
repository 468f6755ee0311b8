//! Resource needs of a stage. Never part of a key: a stage gives the same bytes on every machine.

/// Resources that a stage uses while it runs.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Needs {
    /// Threads that it keeps busy, at least 1. The engine runs stages in parallel up to the number of hardware threads.
    pub threads: usize,
    /// Estimated work, roughly in seconds on one thread. The engine starts the longest chains first. It affects the order
    /// of stages, never a result.
    pub cost: f64,
}

impl Default for Needs {
    fn default() -> Self {
        Self { threads: 1, cost: 1.0 }
    }
}

impl Needs {
    /// One thread for about `seconds`.
    pub fn seconds(seconds: f64) -> Self {
        Self { threads: 1, cost: seconds }
    }
}
