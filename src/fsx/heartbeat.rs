//! The sign of life of all leases of this process: one thread touches their files, and notices those that were taken over.

use std::io;
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::sync::{Arc, Mutex, OnceLock, PoisonError};
use std::time::Duration;

use rustix::fs::{AtFlags, CWD, Timespec, Timestamps, UTIME_NOW, utimensat};

use super::clock;
use super::lease_file::{Seen, WORK};

/// Leases are touched so many times in their patience.
const TIMES: u32 = 6;

/// The leases of this process.
static BEATS: Mutex<Vec<Arc<Beat>>> = Mutex::new(Vec::new());

/// A lease that is touched.
#[derive(Debug)]
pub(super) struct Beat {
    pub path: PathBuf,
    /// What it says, unique to it.
    pub text: String,
    /// When the last successful touch began, in milliseconds since boot.
    last: AtomicU64,
    lost: AtomicBool,
    also: OnceLock<PathBuf>,
    on_loss: OnceLock<fn()>,
}

impl Beat {
    /// True once another process was seen to have taken it over.
    pub fn is_lost(&self) -> bool {
        self.lost.load(Ordering::SeqCst)
    }

    /// How long ago it was touched, by the clock of this machine.
    pub fn age(&self) -> Duration {
        Duration::from_millis(clock::since_boot().saturating_sub(self.last.load(Ordering::SeqCst)))
    }

    pub fn touch_also(&self, path: PathBuf) {
        let _ = self.also.set(path);
    }

    pub fn on_loss(&self, act: fn()) {
        let _ = self.on_loss.set(act);
    }

    fn beat(&self) {
        let began = clock::since_boot();
        match Seen::at(&self.path) {
            Ok(Some(seen)) if seen.text() == self.text => {
                if touch(&self.path).is_ok() {
                    self.last.store(began, Ordering::SeqCst);
                }
                if let Some(path) = self.also.get() {
                    let _ = touch(path);
                }
            }
            Ok(_) => {
                self.lost.store(true, Ordering::SeqCst);
                if let Some(act) = self.on_loss.get() {
                    act();
                }
            }
            // The next time, perhaps.
            Err(_) => {}
        }
    }
}

/// Begins to touch a lease that was made at `began`, in milliseconds since boot.
pub(super) fn begin(path: PathBuf, text: String, began: u64, patience: Duration) -> Arc<Beat> {
    static THREAD: OnceLock<()> = OnceLock::new();
    let beat = Arc::new(Beat {
        path,
        text,
        last: AtomicU64::new(began),
        lost: AtomicBool::new(false),
        also: OnceLock::new(),
        on_loss: OnceLock::new(),
    });
    lock().push(Arc::clone(&beat));
    THREAD.get_or_init(|| {
        let pause = patience.min(super::fault::patience(WORK)) / TIMES;
        // Without it, leases are lost when they are old, and their owners notice.
        let _ = std::thread::Builder::new().name("heartbeat".to_owned()).spawn(move || {
            loop {
                std::thread::sleep(pause);
                let beats = lock().clone();
                beats.iter().filter(|beat| !beat.is_lost()).for_each(|beat| beat.beat());
            }
        });
    });
    beat
}

/// Ends it.
pub(super) fn end(beat: &Arc<Beat>) {
    lock().retain(|other| !Arc::ptr_eq(other, beat));
}

fn lock() -> std::sync::MutexGuard<'static, Vec<Arc<Beat>>> {
    BEATS.lock().unwrap_or_else(PoisonError::into_inner)
}

/// Sets the time of a file to that of its file server.
pub(super) fn touch(path: &Path) -> io::Result<()> {
    let now = Timespec { tv_sec: 0, tv_nsec: UTIME_NOW };
    let times = Timestamps { last_access: now, last_modification: now };
    Ok(utimensat(CWD, path, &times, AtFlags::empty())?)
}
