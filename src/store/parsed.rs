//! Memos of parsed pipeline files, which save time. Correctness does not depend on them: readers check that they are intact.

use super::{Digest, Store, StoreError};
use crate::fsx;

impl Store {
    /// The memo of that name; empty where it cannot be read.
    pub fn parsed(&self, name: &Digest) -> Vec<u8> {
        fsx::read_if_there(&self.root().join("parsed-v1").join(name.hex())).ok().flatten().unwrap_or_default()
    }

    /// Stores a memo. It need not survive a power failure.
    pub fn keep_parsed(&self, name: &Digest, bytes: &[u8]) -> Result<(), StoreError> {
        let folder = self.root().join("parsed-v1");
        fsx::create_dir_all(&folder)?;
        let draft = folder.join(format!("{name}.{}", std::process::id()));
        fsx::write(&draft, bytes)?;
        Ok(fsx::rename(&draft, &folder.join(name.hex()))?)
    }
}
