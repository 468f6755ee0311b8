//! Stores that know each other only by a shared cache, which is kept in memory and fails.

use std::sync::atomic::{AtomicBool, AtomicUsize, Ordering};
use std::time::Duration;

use serde_json::{Value, json};

use super::memory::Memory;
use super::*;
use crate::fsx;
use crate::plan::key_of_record;
use crate::store::{Digest, Fingerprint, Outputs, Stored};

fn key_of(record: &Record) -> Option<Key> {
    key_of_record(record).ok()
}

struct Machine {
    folder: tempfile::TempDir,
    store: Store,
}

impl Machine {
    fn new() -> Self {
        let folder = tempfile::tempdir().unwrap();
        let store = Store::open(&folder.path().join("store")).unwrap();
        Self { folder, store }
    }

    /// Makes a result with outputs of these texts; `name` is all that its key depends on.
    fn make(&self, name: &str, texts: &[&str]) -> Key {
        let run = self.store.begin_run(&Value::Null).unwrap();
        let mut outputs = Outputs::new();
        let mut blobs = Vec::new();
        for (number, text) in texts.iter().enumerate() {
            let path = run.temporary().join("output");
            let folder = text.contains('/');
            if folder {
                for file in text.split(' ') {
                    let to = path.join(file);
                    fsx::create_dir_all(to.parent().unwrap()).unwrap();
                    fsx::write(&to, format!("{name} {file}").as_bytes()).unwrap();
                }
            } else {
                fsx::write(&path, text.as_bytes()).unwrap();
            }
            let blob = if folder { self.store.take_folder(&path) } else { self.store.take(&path) }.unwrap();
            let _ = fsx::remove_dir_all(&path);
            let (digest, bytes) = (blob.digest, blob.bytes);
            let stored = Stored { digest, bytes, extension: "txt".into(), folder, executable: false };
            outputs.insert(format!("o{number}"), stored);
            blobs.push(blob);
        }
        let record = Record {
            version: RECORD_VERSION,
            stage: name.to_owned(),
            kind: "make".to_owned(),
            revision: 1,
            params: json!({ "name": name }),
            seed: None,
            inputs: Vec::new(),
            outputs,
            seconds: 0.5,
            fingerprint: Fingerprint::current(),
        };
        let key = key_of(&record).unwrap();
        self.store.commit(&key, &record, &blobs, run.temporary()).unwrap();
        key
    }

    fn push(&self, remote: &Remote, keys: &[Key]) -> Pushed {
        remote.push(&self.store, keys, &AtomicBool::new(false), &|| {})
    }

    fn pull(&self, remote: &Remote, keys: &[Key]) -> Pulled {
        remote.pull(&self.store, keys, &AtomicBool::new(false), &|| {}).unwrap()
    }

    /// Every content and record matches its name.
    fn is_sound(&self) -> bool {
        self.store.verify(key_of, false).unwrap().damage.is_empty()
    }

    fn outputs(&self, key: &Key) -> Outputs {
        self.store.record(key).unwrap().unwrap().outputs
    }
}

fn remote(memory: &Memory) -> Remote {
    Remote::over(Box::new(memory.clone()), 4, None, Duration::ZERO, key_of)
}

/// Results of all forms: files that share contents, folders that share files, an empty file.
fn samples(machine: &Machine, count: usize) -> Vec<Key> {
    let make = |number: usize| match number % 4 {
        0 => machine.make(&format!("a{number}"), &["same", &"long ".repeat(number * 1000)]),
        1 => machine.make(&format!("b{number}"), &["x/one x/two y/three"]),
        2 => machine.make(&format!("c{number}"), &[""]),
        _ => machine.make(&format!("d{number}"), &["same", &format!("text {number}")]),
    };
    (0..count).map(make).collect()
}

#[test]
fn what_one_machine_gave_another_one_takes_and_nothing_moves_twice() {
    let (one, other, memory) = (Machine::new(), Machine::new(), Memory::default());
    let keys = samples(&one, 20);
    let pushed = one.push(&remote(&memory), &keys);
    assert_eq!((pushed.new, pushed.known, pushed.failed.len()), (20, 0, 0));
    let pulled = other.pull(&remote(&memory), &keys);
    assert_eq!((pulled.new.len(), pulled.known, pulled.absent, pulled.refused.len()), (20, 0, 0, 0));
    assert!(other.is_sound());
    for key in &keys {
        assert_eq!(one.store.record(key).unwrap(), other.store.record(key).unwrap());
        assert_eq!(other.store.lost(&other.outputs(key)).unwrap(), None);
    }
    let again = one.push(&remote(&memory), &keys);
    assert_eq!((again.new, again.known, again.contents), (0, 20, 0));
    let again = other.pull(&remote(&memory), &keys);
    assert_eq!((again.new.len(), again.known, again.contents), (0, 20, 0));
    assert_eq!(remote(&memory).keys().unwrap().len(), 20);
    assert!(fsx::list(&other.folder.path().join("store/runs-v1")).unwrap().is_empty(), "a pull is no run");
}

#[test]
fn what_is_not_there_is_absent_and_costs_one_request() {
    let (machine, memory) = (Machine::new(), Memory::default());
    let keys: Vec<Key> = (0..9).map(|byte| Key::new([byte; 32])).collect();
    let pulled = machine.pull(&remote(&memory), &keys);
    assert_eq!((pulled.absent, pulled.given_up), (9, None));
    assert_eq!(memory.requests.load(Ordering::Relaxed), 9);
    assert!(!machine.store.root().exists(), "nothing was taken, nothing is written");
}

#[test]
fn a_push_cut_off_at_any_request_shows_no_half_and_the_next_one_goes_on() {
    let (one, memory) = (Machine::new(), Memory::default());
    let keys = samples(&one, 8);
    let mut most = 0;
    loop {
        // Every attempt comes one request further than the one before.
        let left = AtomicUsize::new(most);
        let stop = AtomicBool::new(false);
        let cut = Cut { memory: memory.clone(), left };
        let cut = Remote::over(Box::new(cut), 1, None, Duration::ZERO, key_of);
        let pushed = cut.push(&one.store, &keys, &stop, &|| {});
        let objects = memory.objects.lock().unwrap().clone();
        for (name, bytes) in objects.iter().filter(|(name, _)| name.starts_with(RECORDS)) {
            let record: Record = serde_json::from_slice(bytes).unwrap();
            for stored in record.outputs.values() {
                for (digest, length) in one.store.contents(stored).unwrap() {
                    let content = objects.get(&blob_name(&digest)).map(|bytes| bytes.len() as u64);
                    assert_eq!(content, Some(length), "{name} is visible without {}", digest.short());
                }
            }
        }
        if pushed.given_up.is_none() && pushed.failed.is_empty() {
            break;
        }
        most += 1;
    }
    assert!(most > 15, "{most}");
    let other = Machine::new();
    assert_eq!(other.pull(&remote(&memory), &keys).new.len(), 8);
    assert!(other.is_sound());
}

/// A server that is gone after some requests.
struct Cut {
    memory: Memory,
    left: AtomicUsize,
}

impl Cut {
    fn pass(&self) -> Result<(), WireError> {
        let left = self.left.fetch_update(Ordering::SeqCst, Ordering::SeqCst, |left| left.checked_sub(1));
        left.map(drop).map_err(|_| WireError::new(Fault::Permanent, "gone"))
    }
}

impl Wire for Cut {
    fn get(&self, name: &str, into: &mut dyn std::io::Write, limit: u64) -> Result<Option<u64>, WireError> {
        self.pass().and_then(|()| self.memory.get(name, into, limit))
    }
    fn size(&self, name: &str) -> Result<Option<u64>, WireError> {
        self.pass().and_then(|()| self.memory.size(name))
    }
    fn create(&self, name: &str, bytes: Vec<u8>) -> Result<bool, WireError> {
        self.pass().and_then(|()| self.memory.create(name, bytes))
    }
    fn upload(
        &self,
        name: &str,
        file: &std::path::Path,
        length: u64,
        accept: &mut dyn FnMut(&[u8]) -> bool,
    ) -> Result<(), WireError> {
        self.pass().and_then(|()| self.memory.upload(name, file, length, accept))
    }
    fn list(&self, folder: &str) -> Result<Vec<String>, WireError> {
        self.memory.list(folder)
    }
    fn is_read_only(&self) -> bool {
        false
    }
}

#[test]
fn a_network_that_loses_cuts_and_flips_costs_time_and_no_byte() {
    // A round counts only where no answer was wrong. With one in three, that is a few rounds in a hundred.
    const MOST_ROUNDS: u32 = 5000;
    let (one, memory) = (Machine::new(), Memory::default());
    let keys = samples(&one, 24);
    for faults in [3, 5, 9] {
        memory.objects.lock().unwrap().clear();
        memory.faults.store(faults, Ordering::Relaxed);
        let mut rounds = 0;
        while one.push(&remote(&memory), &keys).known < keys.len() {
            rounds += 1;
            assert!(rounds < MOST_ROUNDS);
        }
        let other = Machine::new();
        let mut rounds = 0;
        while other.pull(&remote(&memory), &keys).known < keys.len() {
            rounds += 1;
            assert!(rounds < MOST_ROUNDS);
            assert!(other.is_sound());
        }
        for key in &keys {
            assert_eq!(one.outputs(key), other.outputs(key));
        }
    }
}

#[test]
fn what_is_damaged_or_forged_in_the_cache_is_refused_and_the_rest_is_taken() {
    let (one, memory) = (Machine::new(), Memory::default());
    let [damaged, short, gone, forged, old, no_json, good] =
        ["damaged", "short", "gone", "forged", "old", "no json", "good"].map(|name| one.make(name, &[name]));
    let keys = [damaged, short, gone, forged, old, no_json, good];
    one.push(&remote(&memory), &keys);
    let blob = |text: &str| blob_name(&Digest::of(text.as_bytes()));
    {
        let mut objects = memory.objects.lock().unwrap();
        objects.insert(blob("damaged"), b"damagee".to_vec());
        objects.insert(blob("short"), b"sho".to_vec());
        objects.remove(&blob("gone"));
        let other = objects[&record_name(&good)].clone();
        objects.insert(record_name(&forged), other);
        let text = String::from_utf8(objects[&record_name(&old)].clone()).unwrap();
        objects.insert(record_name(&old), text.replace("\"version\":1", "\"version\":2").into_bytes());
        objects.insert(record_name(&no_json), b"<html>".to_vec());
    }
    let other = Machine::new();
    let pulled = other.pull(&remote(&memory), &keys);
    assert_eq!((pulled.new, pulled.given_up), (vec![good], None));
    let why = |key: Key| pulled.refused.iter().find(|problem| problem.key == key).unwrap().why.clone();
    assert!(why(damaged).contains("is damaged there"), "{}", why(damaged));
    assert!(why(short).contains("is damaged there"), "{}", why(short));
    assert!(why(gone).contains("is not there"), "{}", why(gone));
    assert!(why(forged).contains("that of other work"), "{}", why(forged));
    assert!(why(old).contains("version 2"), "{}", why(old));
    assert!(why(no_json).contains("cannot be read"), "{}", why(no_json));
    assert!(other.is_sound());
    // A content that is missing or too short comes back with the next push of its result.
    one.push(&remote(&memory), &[short, gone]);
    assert_eq!(other.pull(&remote(&memory), &[short, gone]).new.len(), 2);
}

#[test]
fn the_second_one_to_give_a_result_learns_that_its_stage_is_not_deterministic() {
    let (one, other, memory) = (Machine::new(), Machine::new(), Memory::default());
    let key = one.make("stage", &["same", "one"]);
    assert_eq!(other.make("stage", &["same", "two"]), key);
    assert_eq!(one.push(&remote(&memory), &[key]).new, 1);
    let pushed = other.push(&remote(&memory), &[key]);
    assert_eq!((pushed.new, pushed.known), (0, 0));
    let [different] = &*pushed.different else { panic!("{pushed:?}") };
    let text = different.to_string();
    assert!(text.starts_with("`stage` is not deterministic: output `o1` is "), "{text}");
    assert_eq!(different.there, Some(Digest::of(b"one")));
    assert_eq!(remote(&memory).compare(&other.store, &[key]).different, pushed.different);
}

#[test]
fn eight_machines_that_give_the_same_results_at_once_leave_one_of_each() {
    let memory = Memory::default();
    let machines: Vec<(Machine, Vec<Key>)> = (0..8)
        .map(|_| {
            let machine = Machine::new();
            let keys = samples(&machine, 12);
            (machine, keys)
        })
        .collect();
    let new = std::sync::Mutex::new(0);
    std::thread::scope(|scope| {
        for (machine, keys) in &machines {
            let (memory, new) = (&memory, &new);
            scope.spawn(move || {
                let pushed = machine.push(&remote(memory), keys);
                assert_eq!((pushed.new + pushed.known, pushed.different.len()), (12, 0));
                *new.lock().unwrap() += pushed.new;
            });
        }
    });
    assert_eq!(new.into_inner().unwrap(), 12);
}

#[test]
fn a_content_that_is_damaged_here_is_not_given() {
    let (one, memory) = (Machine::new(), Memory::default());
    let key = one.make("stage", &["text"]);
    let path = one.store.blob_path(&Digest::of(b"text"));
    fsx::remove_file(&path).unwrap();
    fsx::write(&path, b"tent").unwrap();
    let pushed = one.push(&remote(&memory), &[key]);
    assert!(pushed.failed[0].why.contains("is damaged in this store"), "{pushed:?}");
    assert!(memory.names().is_empty());
}

#[test]
fn a_cache_that_is_down_is_asked_a_few_times_whatever_there_is_to_move() {
    let (one, memory) = (Machine::new(), Memory::default());
    let keys = samples(&one, 30);
    memory.down.store(true, Ordering::Relaxed);
    assert_eq!(one.push(&remote(&memory), &keys).given_up.as_deref(), Some("the connection was cut"));
    assert!(Machine::new().pull(&remote(&memory), &keys).given_up.is_some());
    assert!(remote(&memory).keys().is_err());
    let requests = memory.requests.load(Ordering::Relaxed);
    assert!(requests < 100, "{requests}");
}

#[test]
fn with_a_secret_only_records_that_were_signed_with_it_are_taken() {
    let (one, memory) = (Machine::new(), Memory::default());
    let (mine, theirs) = (one.make("mine", &["mine"]), one.make("theirs", &["theirs"]));
    let secret = Secret::new("a secret of some length");
    let signing = Remote::over(Box::new(memory.clone()), 4, secret, Duration::ZERO, key_of);
    one.push(&signing, &[mine]);
    one.push(&remote(&memory), &[theirs]);
    let pulled = Machine::new().pull(&signing, &[mine, theirs]);
    assert_eq!(pulled.new, [mine]);
    assert!(pulled.refused[0].why.contains("is not signed"), "{pulled:?}");
    assert_eq!(Machine::new().pull(&remote(&memory), &[mine, theirs]).new.len(), 2);
}

#[test]
fn what_is_being_made_here_is_left_alone() {
    let (one, other, memory) = (Machine::new(), Machine::new(), Memory::default());
    let key = one.make("stage", &["text"]);
    one.push(&remote(&memory), &[key]);
    let _run = other.store.begin_run(&Value::Null).unwrap();
    let lock = other.store.try_lock(&key).unwrap().unwrap();
    assert_eq!(other.pull(&remote(&memory), &[key]).known, 1);
    assert_eq!(other.store.record(&key).unwrap(), None);
    lock.remove().unwrap();
    assert_eq!(other.pull(&remote(&memory), &[key]).new, [key]);
}

#[test]
fn names_in_the_cache_are_those_of_a_store() {
    let machine = Machine::new();
    let key = machine.make("stage", &["text"]);
    let below = |path: std::path::PathBuf| {
        path.strip_prefix(machine.store.root()).unwrap().to_string_lossy().into_owned()
    };
    assert_eq!(record_name(&key), below(machine.store.record_path(&key)));
    let digest = Digest::of(b"text");
    assert_eq!(blob_name(&digest), below(machine.store.blob_path(&digest)));
}
