//! Requests with second tries, and an end to them: a shared cache that does not answer is given up for the rest of the
//! command, so that it costs time once and not for every object.

use std::path::Path;
use std::sync::atomic::{AtomicBool, AtomicU32, Ordering};
use std::sync::{Condvar, Mutex, PoisonError};
use std::time::Duration;

use super::wire::{Fault, Wire, WireError};

/// How often a request is made before it counts as failed.
const TRIES: u32 = 4;
/// Requests that fail one after the other, each after all its tries, until the cache is given up.
const FAILURES: u32 = 3;

/// A shared cache, as long as it answers.
pub(super) struct Link {
    wire: Box<dyn Wire>,
    /// Before the second try; twice as long before each further one.
    pause: Duration,
    /// Requests that may be under way at the same time.
    free: Mutex<usize>,
    freed: Condvar,
    failures: AtomicU32,
    given_up: AtomicBool,
    last_words: Mutex<Option<String>>,
}

/// Why there is no answer.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(super) enum Trouble {
    /// The cache was given up, now or before.
    GivenUp,
    /// This request failed; others may not.
    Failed(String),
}

impl Link {
    pub fn new(wire: Box<dyn Wire>, parallel: usize, pause: Duration) -> Self {
        Self {
            wire,
            pause,
            free: Mutex::new(parallel.max(1)),
            freed: Condvar::new(),
            failures: AtomicU32::new(0),
            given_up: AtomicBool::new(false),
            last_words: Mutex::new(None),
        }
    }

    /// One that was given up from the start.
    pub fn gone(why: String) -> Self {
        let link = Self::new(Box::new(Gone), 1, Duration::ZERO);
        let _ = link.failed(WireError::new(Fault::Permanent, why));
        link
    }

    pub fn is_read_only(&self) -> bool {
        self.wire.is_read_only()
    }

    /// Why the cache was given up; `None` as long as it was not.
    pub fn given_up(&self) -> Option<String> {
        let last_words = || self.last_words.lock().unwrap_or_else(PoisonError::into_inner).clone();
        self.given_up.load(Ordering::SeqCst).then(|| last_words().unwrap_or_default())
    }

    /// Makes a request, again and again as long as that may help.
    pub fn ask<T>(&self, mut request: impl FnMut(&dyn Wire) -> Result<T, WireError>) -> Result<T, Trouble> {
        let _permit = self.permit();
        let mut pause = self.pause;
        for again in (0..TRIES).rev() {
            if self.given_up.load(Ordering::SeqCst) {
                return Err(Trouble::GivenUp);
            }
            match request(&*self.wire) {
                Ok(answer) => {
                    self.failures.store(0, Ordering::SeqCst);
                    return Ok(answer);
                }
                Err(WireError { fault: Fault::Object, text }) => return Err(Trouble::Failed(text)),
                Err(WireError { fault: Fault::Transient, .. }) if again > 0 => {
                    std::thread::sleep(pause);
                    pause *= 2;
                }
                Err(error) => return Err(self.failed(error)),
            }
        }
        Err(Trouble::GivenUp)
    }

    fn failed(&self, error: WireError) -> Trouble {
        let in_a_row = self.failures.fetch_add(1, Ordering::SeqCst) + 1;
        if error.fault == Fault::Permanent || in_a_row >= FAILURES {
            let mut last_words = self.last_words.lock().unwrap_or_else(PoisonError::into_inner);
            last_words.get_or_insert(error.text);
            self.given_up.store(true, Ordering::SeqCst);
            Trouble::GivenUp
        } else {
            Trouble::Failed(error.text)
        }
    }

    fn permit(&self) -> Permit<'_> {
        let free = self.free.lock().unwrap_or_else(PoisonError::into_inner);
        let mut free = self.freed.wait_while(free, |free| *free == 0).unwrap_or_else(PoisonError::into_inner);
        *free -= 1;
        Permit(self)
    }
}

/// Replaces a server.
struct Gone;

impl Wire for Gone {
    fn get(&self, _: &str, _: &mut dyn std::io::Write, _: u64) -> Result<Option<u64>, WireError> {
        Ok(None)
    }

    fn size(&self, _: &str) -> Result<Option<u64>, WireError> {
        Ok(None)
    }

    fn create(&self, _: &str, _: Vec<u8>) -> Result<bool, WireError> {
        Ok(false)
    }

    fn upload(&self, _: &str, _: &Path, _: u64, _: &mut dyn FnMut(&[u8]) -> bool) -> Result<(), WireError> {
        Ok(())
    }

    fn list(&self, _: &str) -> Result<Vec<String>, WireError> {
        Ok(Vec::new())
    }

    fn is_read_only(&self) -> bool {
        false
    }
}

/// The right to make a request.
struct Permit<'a>(&'a Link);

impl Drop for Permit<'_> {
    fn drop(&mut self) {
        *self.0.free.lock().unwrap_or_else(PoisonError::into_inner) += 1;
        self.0.freed.notify_one();
    }
}

/// Does `work` on all items with so many threads. Ends early once `stop` returns true.
pub(super) fn in_parallel<T: Sync>(items: &[T], threads: usize, stop: &AtomicBool, work: impl Fn(&T) + Sync) {
    let next = std::sync::atomic::AtomicUsize::new(0);
    let one_after_the_other = || {
        while let Some(item) = items.get(next.fetch_add(1, Ordering::Relaxed)) {
            if stop.load(Ordering::Relaxed) {
                return;
            }
            work(item);
        }
    };
    std::thread::scope(|scope| {
        for _ in 1..threads.min(items.len()) {
            scope.spawn(one_after_the_other);
        }
        one_after_the_other();
    });
}

#[cfg(test)]
mod tests {
    use super::super::memory::Memory;
    use super::*;

    fn link() -> Link {
        Link::new(Box::new(Memory::default()), 2, Duration::ZERO)
    }

    fn fails(fault: Fault) -> Result<(), WireError> {
        Err(WireError::new(fault, "no answer"))
    }

    #[test]
    fn a_request_that_may_succeed_is_made_again_and_one_that_cannot_is_not() {
        for (fault, expected) in [(Fault::Transient, TRIES), (Fault::Permanent, 1), (Fault::Object, 1)] {
            let (link, mut made) = (link(), 0);
            let answer = link.ask(|_| {
                made += 1;
                fails(fault)
            });
            assert!(answer.is_err());
            assert_eq!(made, expected, "{fault:?}");
        }
        let (link, mut made) = (link(), 0);
        let answer = link.ask(|_| {
            made += 1;
            if made < 3 { fails(Fault::Transient) } else { Ok(()) }
        });
        assert_eq!((answer, made), (Ok(()), 3));
    }

    #[test]
    fn a_cache_that_does_not_answer_is_given_up_and_asked_no_more() {
        let (link, mut made) = (link(), 0);
        for _ in 0..10 {
            let _ = link.ask(|_| {
                made += 1;
                fails(Fault::Transient)
            });
        }
        assert_eq!(made, TRIES * FAILURES);
        assert_eq!(link.given_up().as_deref(), Some("no answer"));
        assert_eq!(link.ask(|_| Ok(())), Err(Trouble::GivenUp));
    }

    #[test]
    fn single_failures_between_answers_do_not_end_it() {
        let link = link();
        for _ in 0..10 {
            let _ = link.ask(|_| fails(Fault::Transient));
            let _ = link.ask(|_| fails(Fault::Object));
            assert_eq!(link.ask(|_| Ok(())), Ok(()));
        }
        assert_eq!(link.given_up(), None);
    }

    #[test]
    fn all_items_are_worked_on_once_whatever_the_number_of_threads() {
        for threads in [0, 1, 3, 50] {
            let items: Vec<u64> = (0..20).collect();
            let sum = std::sync::atomic::AtomicU64::new(0);
            in_parallel(&items, threads, &AtomicBool::new(false), |item| {
                sum.fetch_add(1 << item, Ordering::Relaxed);
            });
            assert_eq!(sum.load(Ordering::Relaxed), (1 << 20) - 1);
        }
    }
}
