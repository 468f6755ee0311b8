//! Entry points for fuzzing: every format that this program reads and that others may have written, as a function of
//! bytes. The fuzzers in `fuzz/` and a test call them. A function returns for valid and invalid bytes alike; its assertions hold
//! for all bytes.
#![doc(hidden)]

use std::path::Path;

use dril_stage_api::{Message, Registry};

use crate::fsx;
use crate::plan::key_of_record;
use crate::resolve::{self, Choices};
use crate::session::LockFile;
use crate::spec::{self, Memo, SourceName};
use crate::store::{Record, Store};

/// A function of bytes.
pub type Reader = fn(&[u8], &Registry);

/// All of them, by name.
pub const READERS: [(&str, Reader); 9] = [
    ("pipeline", pipeline),
    ("memo", memo),
    ("set", set),
    ("record", record),
    ("history", history),
    ("events", events),
    ("lock", lock),
    ("archive", archive),
    ("message", message),
];

/// A pipeline file: read, resolved, and every mistake shown.
pub fn pipeline(bytes: &[u8], registry: &Registry) {
    let name = SourceName("fuzzed.yaml".to_owned());
    let parsed = match spec::parse_bytes(bytes, &name) {
        Ok(spec) => resolve::resolve(&spec, &Choices::default(), registry).map(drop),
        Err(diagnostics) => Err(diagnostics),
    };
    if let Err(diagnostics) = parsed {
        let text = diagnostics.to_string();
        assert!(text.contains("error:"), "a mistake has a text");
    }
    if let Ok(text) = std::str::from_utf8(bytes) {
        assert!(spec::pieces_agree(text), "pieces are what the whole is");
    }
}

/// The pipeline file of [`memo`].
pub const MEMO_TEXT: &[u8] = b"name: x
stages:
  a: { kind: command, with: { run: [a, 1.5], outputs: { x: !replace {} } } }
  b:
    kind: null
    with: { t: true }
";

/// What is known of the stages of a file: whatever it is, the file is read.
pub fn memo(bytes: &[u8], registry: &Registry) {
    // With a digest that is right, so that the bytes behind it are read.
    let bytes = [blake3::hash(bytes).as_bytes(), bytes].concat();
    let none = &mut |_: &str| Err(std::io::Error::other("files cannot be read here"));
    let name = SourceName("fuzzed.yaml".to_owned());
    if let Ok(spec) = spec::parse_remembering(MEMO_TEXT, &name, none, &mut Memo::read(bytes)) {
        let _ = resolve::resolve(&spec, &Choices::default(), registry);
    }
}

/// An argument of `--set`.
pub fn set(bytes: &[u8], registry: &Registry) {
    let Ok(set) = std::str::from_utf8(bytes) else { return };
    let text = b"name: x\nparams: { a: { b: 1 } }\nstages: {}\n";
    let Ok(spec) = spec::parse_bytes(text, &SourceName("fuzzed.yaml".to_owned())) else { return };
    let choices = Choices { set: vec![set.to_owned()], ..Choices::default() };
    let _ = resolve::resolve(&spec, &choices, registry);
}

/// A record: what is read is written as it was read, and has one key.
pub fn record(bytes: &[u8], _: &Registry) {
    let Ok(record) = serde_json::from_slice::<Record>(bytes) else { return };
    let key = key_of_record(&record);
    let written = serde_json::to_vec(&record).unwrap_or_default();
    if let Ok(again) = serde_json::from_slice::<Record>(&written) {
        assert_eq!(key_of_record(&again).ok(), key.ok(), "a record keeps its key");
    }
}

/// A history file.
pub fn history(bytes: &[u8], _: &Registry) {
    in_store(|root, store| {
        let path = root.join("history-v1").join("p-q.jsonl");
        if put(&path, bytes)
            && let Ok(mut history) = store.history("p", "q")
        {
            assert!(history.compact().is_ok(), "a history that was read can be written");
        }
    });
}

/// The manifest and the events of a run.
pub fn events(bytes: &[u8], _: &Registry) {
    in_store(|root, store| {
        let id = "20260101-000000-000000000-1";
        let folder = root.join("runs-v1").join(id);
        if put(&folder.join("events.jsonl"), bytes) && put(&folder.join("run.json"), bytes) {
            let run = store.past_run(id);
            assert!(run.is_ok(), "whatever a run left can be looked at");
        }
    });
}

/// A lock file: what is read is written so that it is read the same again.
pub fn lock(bytes: &[u8], _: &Registry) {
    let path = Path::new("fuzzed.lock");
    let Ok(lock) = LockFile::parse(bytes, path) else { return };
    let again = LockFile::parse(lock.text().as_bytes(), path);
    assert_eq!(again.ok(), Some(lock), "a lock file is read as it was written");
}

/// An archive of a run: whatever is in it, the store that took it is sound.
pub fn archive(bytes: &[u8], _: &Registry) {
    in_store(|root, store| {
        let path = root.with_extension("zip");
        if put(&path, bytes) {
            let _ = store.import_archive(&path, |record| key_of_record(record).ok());
            let _ = fsx::remove_file(&path);
            let verified = store.verify(|record| key_of_record(record).ok(), false);
            assert!(verified.is_ok_and(|verified| verified.damage.is_empty()), "nothing wrong was taken");
        }
    });
}

/// A line that a stage printed.
pub fn message(bytes: &[u8], _: &Registry) {
    if let Ok(text) = std::str::from_utf8(bytes)
        && let Some(message) = Message::from_line(text)
    {
        assert!(!message.to_line().contains('\n'), "a message is one line");
    }
    let _ = super::terminal::printable(&String::from_utf8_lossy(bytes));
}

/// Does something with a store in a folder that goes away afterwards.
fn in_store(work: impl FnOnce(&Path, &Store)) {
    let memory = Path::new("/dev/shm");
    let folder = if memory.is_dir() { tempfile::tempdir_in(memory) } else { tempfile::tempdir() };
    if let Ok(folder) = folder {
        let root = folder.path().join("store");
        if let Ok(store) = Store::open(&root) {
            work(&root, &store);
        }
    }
}

/// Writes a file with its folders; false where that cannot be done.
fn put(path: &Path, bytes: &[u8]) -> bool {
    path.parent().is_some_and(|folder| fsx::create_dir_all(folder).is_ok()) && fsx::write(path, bytes).is_ok()
}
