//! The worker threads of a run. One is started when all others are busy, and kept for the rest of the run: a new thread per
//! stage would cost a stage of a few milliseconds a tenth of its time.

use std::sync::atomic::{AtomicUsize, Ordering};
use std::sync::mpsc::{Receiver, Sender, channel};
use std::sync::{Arc, Mutex};
use std::thread::Scope;

/// Threads within a scope that call `work` on tasks.
pub(super) struct Workers<'scope, 'env, T, F> {
    scope: &'scope Scope<'scope, 'env>,
    work: F,
    tasks: Sender<T>,
    queue: Arc<Mutex<Receiver<T>>>,
    /// Threads that wait for a task and have not been assigned one.
    idle: Arc<AtomicUsize>,
}

impl<'scope, 'env, T, F> Workers<'scope, 'env, T, F>
where
    T: Send + 'scope,
    F: Fn(T) + Clone + Send + 'scope,
{
    /// Starts without threads. They end once this is dropped and their tasks are done.
    pub fn new(scope: &'scope Scope<'scope, 'env>, work: F) -> Self {
        let (tasks, queue) = channel();
        Self { scope, work, tasks, queue: Arc::new(Mutex::new(queue)), idle: Arc::default() }
    }

    /// Starts a task at once, on an idle thread or a new one.
    pub fn start(&self, task: T) {
        let one_less = |idle: usize| idle.checked_sub(1);
        let claimed = self.idle.fetch_update(Ordering::AcqRel, Ordering::Acquire, one_less).is_ok();
        let task = if claimed { self.tasks.send(task).err().map(|unsent| unsent.0) } else { Some(task) };
        let Some(first) = task else { return };
        let (work, queue, idle) = (self.work.clone(), Arc::clone(&self.queue), Arc::clone(&self.idle));
        self.scope.spawn(move || {
            let mut next = Some(first);
            while let Some(task) = next {
                work(task);
                idle.fetch_add(1, Ordering::AcqRel);
                next = queue.lock().ok().and_then(|queue| queue.recv().ok());
            }
        });
    }
}

#[cfg(test)]
mod tests {
    use std::collections::HashSet;
    use std::thread::{self, ThreadId};

    use super::*;

    #[test]
    fn tasks_run_at_the_same_time_on_threads_that_are_reused() {
        let (sender, receiver) = channel::<(ThreadId, Sender<()>)>();
        let mut threads = HashSet::new();
        thread::scope(|scope| {
            let workers = Workers::new(scope, |started: Sender<(ThreadId, Sender<()>)>| {
                let (go, wait) = channel();
                started.send((thread::current().id(), go)).unwrap();
                wait.recv().unwrap();
            });
            for _ in 0..50 {
                // Three at a time: each waits until all of them have begun.
                for _ in 0..3 {
                    workers.start(sender.clone());
                }
                let begun: Vec<_> = receiver.iter().take(3).collect();
                let begun: HashSet<ThreadId> =
                    begun.iter().map(|(thread, go)| go.send(()).map(|()| *thread).unwrap()).collect();
                assert_eq!(begun.len(), 3);
                threads.extend(begun);
                while workers.idle.load(Ordering::Acquire) < threads.len() {
                    thread::yield_now();
                }
            }
        });
        assert_eq!(threads.len(), 3);
    }
}
