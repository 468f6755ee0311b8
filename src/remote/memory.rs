//! A server in memory for the tests, which can be made to fail in all ways in which a network fails.

use std::collections::BTreeMap;
use std::io::Write;
use std::path::Path;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::sync::{Arc, Mutex};

use super::wire::{Fault, Wire, WireError};
use crate::fsx;

/// Objects in memory. Clones share them.
#[derive(Clone, Default)]
pub struct Memory {
    pub objects: Arc<Mutex<BTreeMap<String, Vec<u8>>>>,
    /// One in so many requests goes wrong; 0: none.
    pub faults: Arc<AtomicU64>,
    /// Decides which ones, and how.
    dice: Arc<AtomicU64>,
    /// Nothing answers.
    pub down: Arc<AtomicBool>,
    /// Requests made.
    pub requests: Arc<AtomicU64>,
}

/// What goes wrong with a request.
#[derive(Clone, Copy, PartialEq)]
enum Wrong {
    /// Nothing.
    Nothing,
    /// It never arrives.
    Lost,
    /// It arrives, and its answer does not.
    AnswerLost,
    /// The answer is cut, and it shows.
    Cut,
    /// The answer is cut, and looks complete.
    CutInSilence,
    /// A bit of the answer is flipped.
    Flipped,
}

impl Memory {
    pub fn names(&self) -> Vec<String> {
        self.objects.lock().unwrap().keys().cloned().collect()
    }

    fn throw(&self) -> Result<Wrong, WireError> {
        self.requests.fetch_add(1, Ordering::Relaxed);
        if self.down.load(Ordering::Relaxed) {
            return Err(gone());
        }
        let faults = self.faults.load(Ordering::Relaxed);
        // splitmix64, as good as any other.
        let mut x = self.dice.fetch_add(0x9e37_79b9_7f4a_7c15, Ordering::Relaxed);
        x = (x ^ (x >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
        x = (x ^ (x >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
        x ^= x >> 31;
        if faults == 0 || !x.is_multiple_of(faults) {
            return Ok(Wrong::Nothing);
        }
        match (x >> 32) % 6 {
            0 => Err(gone()),
            1 => Ok(Wrong::AnswerLost),
            2 => Ok(Wrong::Cut),
            3 => Ok(Wrong::CutInSilence),
            4 => Ok(Wrong::Flipped),
            _ => Ok(Wrong::Lost),
        }
    }
}

fn gone() -> WireError {
    WireError::new(Fault::Transient, "the connection was cut")
}

impl Wire for Memory {
    fn get(&self, name: &str, into: &mut dyn Write, limit: u64) -> Result<Option<u64>, WireError> {
        let wrong = self.throw()?;
        let Some(mut bytes) = self.objects.lock().unwrap().get(name).cloned() else { return Ok(None) };
        if bytes.len() as u64 > limit {
            return Err(WireError::new(Fault::Object, "too long"));
        }
        match wrong {
            Wrong::Cut | Wrong::CutInSilence => bytes.truncate(bytes.len() / 2),
            Wrong::Flipped => {
                if let Some(byte) = bytes.last_mut() {
                    *byte ^= 1;
                }
            }
            Wrong::Lost | Wrong::AnswerLost => return Err(gone()),
            Wrong::Nothing => {}
        }
        into.write_all(&bytes).unwrap();
        if wrong == Wrong::Cut { Err(gone()) } else { Ok(Some(bytes.len() as u64)) }
    }

    fn size(&self, name: &str) -> Result<Option<u64>, WireError> {
        match self.throw()? {
            Wrong::Nothing => Ok(self.objects.lock().unwrap().get(name).map(|bytes| bytes.len() as u64)),
            _ => Err(gone()),
        }
    }

    fn create(&self, name: &str, bytes: Vec<u8>) -> Result<bool, WireError> {
        let wrong = self.throw()?;
        if matches!(wrong, Wrong::Lost | Wrong::Cut) {
            return Err(gone());
        }
        let mut objects = self.objects.lock().unwrap();
        let new = !objects.contains_key(name);
        objects.entry(name.to_owned()).or_insert(bytes);
        if wrong == Wrong::Nothing { Ok(new) } else { Err(gone()) }
    }

    fn upload(
        &self,
        name: &str,
        file: &Path,
        length: u64,
        accept: &mut dyn FnMut(&[u8]) -> bool,
    ) -> Result<(), WireError> {
        let wrong = self.throw()?;
        let bytes = fsx::read(file).map_err(|error| WireError::new(Fault::Object, error.to_string()))?;
        if bytes.len() as u64 != length || !accept(&bytes) || !accept(&[]) {
            return Err(WireError::new(Fault::Object, "not accepted"));
        }
        if matches!(wrong, Wrong::Lost | Wrong::Cut) {
            return Err(gone());
        }
        self.objects.lock().unwrap().insert(name.to_owned(), bytes);
        if wrong == Wrong::Nothing { Ok(()) } else { Err(gone()) }
    }

    fn list(&self, folder: &str) -> Result<Vec<String>, WireError> {
        if self.throw()? != Wrong::Nothing {
            return Err(gone());
        }
        let folder = format!("{folder}/");
        Ok(self.names().into_iter().filter(|name| name.starts_with(&folder)).collect())
    }

    fn is_read_only(&self) -> bool {
        false
    }
}
