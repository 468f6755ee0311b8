//! What a stage takes of the machine. Never part of a key: the same stage gives the same bytes on any machine.

/// What a stage takes of the machine while it runs.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Needs {
    /// Threads that it keeps busy, at least 1. The engine runs stages side by side up to the machine's threads.
    pub threads: usize,
    /// A rough size of the work in any unit that is the same for all kinds (seconds on one thread will do); the engine
    /// starts the longest chains first. It changes the order of stages, never a result.
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
