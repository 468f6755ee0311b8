//! Gives what a run makes to the shared cache, beside the run: a slow cache does not slow it down.

use std::collections::HashMap;
use std::sync::atomic::AtomicBool;
use std::sync::mpsc::{Receiver, Sender, channel};
use std::thread::{Scope, ScopedJoinHandle};

use super::shared::Shared;
use crate::exec::Event;
use crate::remote::Pushed;
use crate::resolve::StageIndex;
use crate::store::{Key, Store};

/// A thread that gives results, and what it has to know of the run.
struct Giving<'scope> {
    keys: HashMap<StageIndex, Key>,
    sender: Sender<Key>,
    thread: ScopedJoinHandle<'scope, Pushed>,
}

impl<'scope> Giving<'scope> {
    /// Starts the thread. It drops what is left once `stop` is true.
    fn start<'env>(
        scope: &'scope Scope<'scope, 'env>,
        shared: &'env Shared,
        store: &'env Store,
        stop: &'env AtomicBool,
    ) -> Self {
        let (sender, receiver) = channel();
        let thread = scope.spawn(move || give(shared, store, stop, &receiver));
        Self { keys: HashMap::new(), sender, thread }
    }

    /// Takes note of an event; what is finished is given.
    fn event(&mut self, event: &Event) {
        match event {
            Event::StageStarted { stage, key, .. } => drop(self.keys.insert(*stage, *key)),
            Event::StageFinished { stage, .. } => {
                if let Some(key) = self.keys.remove(stage) {
                    // The thread goes only after this end of the channel.
                    let _ = self.sender.send(key);
                }
            }
            _ => {}
        }
    }

    /// Waits until all is given, or the cache was given up.
    fn end(self) -> Pushed {
        drop(self.sender);
        self.thread.join().unwrap_or_default()
    }
}

/// Runs `work`, which passes every event of a run on, and gives meanwhile what is finished to the shared cache, where it is
/// one that results are given to. What came of both.
pub(super) fn beside<T>(
    shared: Option<&Shared>,
    store: &Store,
    stop: &AtomicBool,
    work: impl FnOnce(&mut dyn FnMut(&Event)) -> T,
) -> (T, Pushed) {
    std::thread::scope(|scope| {
        let to = shared.filter(|shared| shared.mode.writes() && !shared.remote.is_read_only());
        let mut giving = to.map(|shared| Giving::start(scope, shared, store, stop));
        let done = work(&mut |event| giving.iter_mut().for_each(|giving| giving.event(event)));
        (done, giving.map(Giving::end).unwrap_or_default())
    })
}

fn give(shared: &Shared, store: &Store, stop: &AtomicBool, finished: &Receiver<Key>) -> Pushed {
    let mut all = Pushed::default();
    while let Ok(first) = finished.recv() {
        let keys: Vec<Key> = std::iter::once(first).chain(finished.try_iter()).collect();
        let pushed = shared.remote.push(store, &keys, stop, &|| {});
        all.new += pushed.new;
        all.known += pushed.known;
        all.contents += pushed.contents;
        all.bytes += pushed.bytes;
        all.different.extend(pushed.different);
        all.failed.extend(pushed.failed);
        all.given_up = pushed.given_up;
    }
    all
}
