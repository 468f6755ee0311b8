//! Disk usage of a store.

use std::collections::{BTreeMap, HashSet};
use std::path::Path;

use super::{Digest, Store, StoreError};
use crate::fsx::{self, Entry};

/// Files and their bytes.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Room {
    /// Files.
    pub files: usize,
    /// Bytes in them.
    pub bytes: u64,
}

/// Disk usage.
#[derive(Clone, Debug, Default)]
pub struct Usage {
    /// By folder of the store.
    pub folders: BTreeMap<String, Room>,
    /// By kind and stage: records, and the bytes of their blobs. A blob of several stages counts for the first.
    pub stages: BTreeMap<(String, String), Room>,
    /// Blobs that are no output of any record: files from outside, and leftovers of crashes.
    pub unnamed: Room,
}

impl Usage {
    /// The total.
    pub fn bytes(&self) -> u64 {
        self.folders.values().map(|room| room.bytes).sum()
    }
}

impl Store {
    /// Measures the store.
    pub fn usage(&self) -> Result<Usage, StoreError> {
        let mut usage = Usage::default();
        for path in fsx::list(self.root())? {
            let name = path.file_name().unwrap_or_default().to_string_lossy().into_owned();
            let room = measure(&path)?;
            if name != "gc.lock" {
                usage.folders.insert(name, room);
            }
        }
        let mut named: HashSet<Digest> = HashSet::new();
        for (_, record) in self.records()? {
            let name = record.stage.split('[').next().unwrap_or_default().to_owned();
            let room = usage.stages.entry((record.kind.clone(), name)).or_default();
            room.files += 1;
            for stored in record.outputs.values() {
                let contents = self.contents(stored)?;
                let new = contents.into_iter().filter(|(digest, _)| named.insert(*digest));
                room.bytes += new.map(|(_, bytes)| bytes).sum::<u64>();
            }
        }
        for (path, name) in self.sharded_files("blobs-v1")? {
            if name.parse::<Digest>().is_ok_and(|digest| !named.contains(&digest)) {
                let Room { files, bytes } = measure(&path)?;
                usage.unnamed.files += files;
                usage.unnamed.bytes += bytes;
            }
        }
        Ok(usage)
    }
}

/// Files and bytes at a path and below; links are not followed, and files that disappear meanwhile are not counted.
pub(super) fn measure(path: &Path) -> fsx::Result<Room> {
    let mut room = Room::default();
    match fsx::entry(path)? {
        Some(Entry::File(bytes)) => room = Room { files: 1, bytes },
        Some(Entry::Folder) => {
            for below in fsx::list(path)? {
                let Room { files, bytes } = measure(&below)?;
                room.files += files;
                room.bytes += bytes;
            }
        }
        Some(Entry::Other) | None => {}
    }
    Ok(room)
}
