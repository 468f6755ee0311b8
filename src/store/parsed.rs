//! Bytes that save time the next time a pipeline file is read. Nothing rests on them: whoever reads them looks whether
//! they are whole.

use super::{Digest, Store, StoreError};
use crate::fsx;

impl Store {
    /// What was kept under `name`; nothing where that cannot be read.
    pub fn parsed(&self, name: &Digest) -> Vec<u8> {
        fsx::read_if_there(&self.root().join("parsed-v1").join(name.hex())).ok().flatten().unwrap_or_default()
    }

    /// Keeps bytes under `name`. Nothing is promised about power failures.
    ///
    /// # Errors
    /// The store cannot be written.
    pub fn keep_parsed(&self, name: &Digest, bytes: &[u8]) -> Result<(), StoreError> {
        let folder = self.root().join("parsed-v1");
        fsx::create_dir_all(&folder)?;
        let draft = folder.join(format!("{name}.{}", std::process::id()));
        fsx::write(&draft, bytes)?;
        Ok(fsx::rename(&draft, &folder.join(name.hex()))?)
    }
}
