//! What a shared cache is reached by: five requests on named objects. One implementation talks to real servers
//! (`object_store`), one of the tests keeps objects in memory and fails on purpose.

use std::io::Write;
use std::path::Path;

/// Requests to a server that keeps objects under names. Each may block for a while, and is called from many threads.
pub trait Wire: Send + Sync {
    /// Writes the object's bytes to `into` as they arrive, at most `limit` of them. The number of bytes written; `None`
    /// where there is no such object. After an error, `into` may have received a part.
    ///
    /// # Errors
    /// The request fails, the connection is cut, or the object is longer than `limit`.
    fn get(&self, name: &str, into: &mut dyn Write, limit: u64) -> Result<Option<u64>, WireError>;

    /// The object's length in bytes; `None` where there is no such object.
    ///
    /// # Errors
    /// The request fails.
    fn size(&self, name: &str) -> Result<Option<u64>, WireError>;

    /// Creates an object if there is none of that name, in one atomic step; false where there is one.
    ///
    /// # Errors
    /// The request fails. The object may have been created nevertheless.
    fn create(&self, name: &str, bytes: Vec<u8>) -> Result<bool, WireError>;

    /// Uploads a file of `length` bytes. The object becomes visible as a whole or not at all, and only if `accept` is
    /// true of all the bytes that were sent, in the order of the calls; `accept` gets an empty slice at the end.
    ///
    /// # Errors
    /// The file cannot be read, `accept` refuses, or the request fails.
    fn upload(
        &self,
        name: &str,
        file: &Path,
        length: u64,
        accept: &mut dyn FnMut(&[u8]) -> bool,
    ) -> Result<(), WireError>;

    /// The names of all objects whose names begin with `folder` and a slash.
    ///
    /// # Errors
    /// The request fails, or the server cannot list.
    fn list(&self, folder: &str) -> Result<Vec<String>, WireError>;

    /// True where objects can only be read.
    fn is_read_only(&self) -> bool;
}

/// Why a request failed.
#[derive(Debug, Clone, thiserror::Error)]
#[error("{text}")]
pub struct WireError {
    /// Whether it is worth another try.
    pub fault: Fault,
    /// What the server or the system said, without credentials.
    pub text: String,
}

/// What sort of failure it is.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Fault {
    /// It may succeed the next time: a cut connection, a server that is busy, a time-out.
    Transient,
    /// It will fail again: no permission, an unknown bucket, a request that the server does not support.
    Permanent,
    /// The fault is in one file or object, here or there; the server may be fine.
    Object,
}

impl WireError {
    /// A failure of that sort.
    pub fn new(fault: Fault, text: impl Into<String>) -> Self {
        Self { fault, text: text.into() }
    }
}
