//! The store by itself, without stages.

use std::collections::BTreeMap;

use serde_json::{Value, json};

use super::*;
use crate::fsx;

/// A record as version 1 writes it. A failure of the tests that read it means that users lose their caches.
const RECORD_V1: &str = include_str!("../../tests/it/formats/record-v1.json");

fn store() -> (tempfile::TempDir, Store) {
    let folder = tempfile::tempdir().unwrap();
    let store = Store::open(&folder.path().join("store")).unwrap();
    (folder, store)
}

fn sample() -> Record {
    let stored = |text: &str| Stored {
        digest: Digest::of(text.as_bytes()),
        bytes: 3,
        extension: "txt".into(),
        folder: false,
        executable: false,
    };
    let item = |from: &str, labels: &[(&str, &str)]| RecordItem {
        from: from.into(),
        labels: labels.iter().map(|(axis, value)| ((*axis).into(), (*value).into())).collect(),
        digest: Digest::of(from.as_bytes()),
        executable: false,
    };
    let input = |port: &str, many, items| RecordInput { port: port.into(), many, items };
    Record {
        version: 1,
        stage: "dril[policy=beta]".into(),
        kind: "dril".into(),
        revision: 2,
        params: json!({"rate": 2.5e-4, "steps": 3, "env": {"car-racing": {"version": "v0"}}, "none": null}),
        seed: Some(u64::MAX),
        inputs: vec![
            input("policy", false, vec![item("clone[policy=beta].policy", &[])]),
            input("scores", true, vec![item("file a b.csv", &[("name", "ü"), ("seed", "1")])]),
        ],
        outputs: [("final".to_owned(), stored("abc")), ("peak".to_owned(), stored("abd"))].into(),
        seconds: 12.5,
        fingerprint: Fingerprint {
            tool: "0.1.0".into(),
            platform: "linux x86_64".into(),
            with: BTreeMap::new(),
        },
    }
}

#[test]
fn a_record_of_version_1_stays_readable() {
    let read: Record = serde_json::from_str(RECORD_V1).unwrap();
    assert_eq!(read, sample());
    assert_eq!(serde_json::to_string(&sample()).unwrap(), RECORD_V1.trim_end());
}

#[test]
fn a_committed_record_is_found_and_a_foreign_one_is_damaged() {
    let (_folder, store) = store();
    let run = store.begin_run(&Value::Null).unwrap();
    let key = Key::new([7; 32]);
    assert_eq!(store.find(&key).unwrap(), Found::Nothing);
    store.commit(&key, &sample(), &[], run.temporary()).unwrap();
    assert_eq!(store.find(&key).unwrap(), Found::Record(Box::new(sample())));
    for wrong in ["", "{}", "[]", &RECORD_V1[..99], &RECORD_V1.replace("\"version\":1", "\"version\":2")] {
        fsx::write(&store.record_path(&key), wrong.as_bytes()).unwrap();
        assert!(matches!(store.find(&key).unwrap(), Found::Damaged(_)), "{wrong}");
        assert_eq!(store.record(&key).unwrap(), None);
    }
}

#[test]
fn opening_writes_nothing_and_a_file_is_no_store() {
    let (folder, store) = store();
    assert_eq!(store.record(&Key::new([0; 32])).unwrap(), None);
    assert!(fsx::list(folder.path()).unwrap().is_empty());
    let file = folder.path().join("file");
    fsx::write(&file, b"").unwrap();
    let text = Store::open(&file).unwrap_err().to_string();
    assert_eq!(text, format!("the store `{}` is not a folder", file.display()));
}

#[test]
fn equal_contents_are_stored_once() {
    let (_folder, store) = store();
    let run = store.begin_run(&Value::Null).unwrap();
    let digests = ["one", "two"].map(|name| {
        let path = run.temporary().join(name);
        fsx::write(&path, b"same").unwrap();
        let blob = store.take(&path).unwrap();
        blob.sync().unwrap();
        (blob.digest, blob.bytes)
    });
    assert_eq!(digests, [(Digest::of(b"same"), 4); 2]);
    assert_eq!(fsx::read(&store.blob_path(&digests[0].0)).unwrap(), b"same");
}

#[test]
fn a_key_is_locked_by_one_at_a_time() {
    let (_folder, store) = store();
    let _run = store.begin_run(&Value::Null).unwrap();
    let (key, other) = (Key::new([1; 32]), Key::new([2; 32]));
    let lock = store.try_lock(&key).unwrap().unwrap();
    assert!(store.try_lock(&key).unwrap().is_none());
    assert!(store.try_lock(&other).unwrap().is_some());
    lock.remove().unwrap();
    assert!(store.try_lock(&key).unwrap().is_some());
}

/// What a power failure leaves is decided by the order in which things become durable; killing a process shows none of it.
#[test]
fn a_record_gets_its_name_only_after_it_and_its_blobs_are_durable() {
    let (folder, store) = store();
    let run = store.begin_run(&Value::Null).unwrap();
    let blobs = ["one", "two"].map(|name| {
        let path = run.temporary().join(name);
        fsx::write(&path, name.as_bytes()).unwrap();
        store.take(&path).unwrap()
    });
    let key = Key::new([3; 32]);
    fsx::fault::watch();
    store.commit(&key, &sample(), &blobs, run.temporary()).unwrap();
    let steps = fsx::fault::seen(folder.path());
    let at = |what: &'static str, path: &Path| {
        let step = steps.iter().position(|step| *step == (what, path.to_owned()));
        step.unwrap_or_else(|| panic!("no `{what}` of {}: {steps:?}", path.display()))
    };
    let record = store.record_path(&key);
    let named = at("rename", &record);
    assert!(at("sync", &run.temporary().join("record.json")) < named);
    assert!(named < at("sync", record.parent().unwrap()));
    for blob in &blobs {
        let path = store.blob_path(&blob.digest);
        assert!(at("sync", &path) < named);
        assert!(at("sync", path.parent().unwrap()) < named);
    }
}

#[test]
fn a_content_that_several_bring_in_at_once_is_put_in_its_place_once() {
    let folder = tempfile::tempdir().unwrap();
    let store = Store::open(&folder.path().join("cache")).unwrap();
    let run = store.begin_run(&serde_json::json!({})).unwrap();
    let path = folder.path().join("file");
    for round in 0..60 {
        let text = format!("content {round}");
        fsx::write(&path, text.as_bytes()).unwrap();
        let digest = Digest::of(text.as_bytes());
        let barrier = std::sync::Barrier::new(4);
        let bring = || {
            barrier.wait();
            store.import(&path, &digest, &run).unwrap();
            fsx::stamp(&store.blob_path(&digest)).unwrap()
        };
        let seen: Vec<_> = std::thread::scope(|scope| {
            let all: Vec<_> = (0..4).map(|_| scope.spawn(bring)).collect();
            all.into_iter().map(|one| one.join().unwrap()).collect()
        });
        // A stage that reads the first one would take another file in its place for one that was changed.
        assert!(seen.iter().all(|look| *look == seen[0]), "round {round}: {seen:?}");
    }
}
