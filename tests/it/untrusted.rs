//! The fuzzers' functions on stable Rust, in every test run: each on its seeds, and on thousands of seeds that were bent.
//! No panic, no hang; `fuzz/` has the same functions for cargo-fuzz, which runs until it is stopped.

use std::path::Path;
use std::time::{Duration, Instant};

use dril_pipe::cli::untrusted::{MEMO_TEXT, READERS};
use dril_pipe::spec::{self, Memo, SourceName};
use proptest::prelude::*;
use proptest::test_runner::{Config, RngSeed, TestRunner};

use crate::cli::WORDS;
use crate::fakes;
use crate::sealed::Sealed;

/// One reading may take this long on a busy machine; a hang takes longer.
const LONGEST: Duration = Duration::from_secs(20);

/// How many bent seeds each reader gets.
fn cases(reader: &str) -> u32 {
    // These write files.
    if ["archive", "history", "events"].contains(&reader) { 150 } else { 600 }
}

fn files(folder: &Path, ending: &str) -> Vec<Vec<u8>> {
    let entries = std::fs::read_dir(folder).unwrap().map(|entry| entry.unwrap().path());
    let mut paths: Vec<_> = entries.filter(|path| path.to_string_lossy().ends_with(ending)).collect();
    paths.sort();
    paths.iter().map(|path| std::fs::read(path).unwrap()).collect()
}

/// What each reader reads when all is well, and what it once stumbled over.
fn seeds(reader: &str) -> Vec<Vec<u8>> {
    let root = Path::new(env!("CARGO_MANIFEST_DIR"));
    let sealed = Sealed::with(WORDS);
    sealed.run_ok("run p.yaml --lock");
    let below = |folder: &str| {
        let store = sealed.path("cache");
        let all = crate::lab::files_below(&store).into_iter().filter(|path| path.contains(folder));
        all.map(|path| std::fs::read(store.join(path)).unwrap()).collect::<Vec<_>>()
    };
    let mut seeds = match reader {
        "pipeline" => [files(&root.join("tests/bad"), ".yaml"), vec![WORDS.into()]].concat(),
        "memo" => {
            let mut memo = Memo::default();
            let none = &mut |_: &str| Err(std::io::Error::other("there is no file"));
            spec::parse_remembering(MEMO_TEXT, &SourceName("p".into()), none, &mut memo).unwrap();
            vec![memo.bytes().unwrap().split_off(32)]
        }
        "set" => ["params.a.b=2", "axes.x=[1, 2]", "seed=3", "stage.with=!replace { a: 1 }"]
            .map(Vec::from)
            .to_vec(),
        "record" => below("records-v1"),
        "history" => [below("history-v1"), files(&root.join("tests/golden"), "history-v1.jsonl")].concat(),
        "events" => below("runs-v1"),
        "lock" => vec![sealed.read("p.lock").into_bytes()],
        "archive" => {
            sealed.run_ok("cache export last -o a.zip");
            vec![std::fs::read(sealed.path("a.zip")).unwrap()]
        }
        _ => vec![br#"{"progress":{"step":1,"total":2,"unit":"x","note":"y"}}"#.to_vec()],
    };
    let known = root.join("fuzz/known").join(reader);
    if known.is_dir() {
        seeds.extend(files(&known, ""));
    }
    assert!(seeds.iter().any(|seed| !seed.is_empty()), "{reader} has seeds");
    seeds
}

/// Some changes to some bytes.
fn bent(seeds: Vec<Vec<u8>>) -> impl Strategy<Value = Vec<u8>> {
    let change = (0_u8..6, any::<prop::sample::Index>(), any::<prop::sample::Index>(), any::<u8>());
    let changes = proptest::collection::vec(change, 1..8);
    (proptest::sample::select(seeds), changes).prop_map(|(mut bytes, changes)| {
        for (what, one, other, byte) in changes {
            if bytes.is_empty() {
                break;
            }
            let (from, to) = (one.index(bytes.len()), other.index(bytes.len()));
            let (from, to) = (from.min(to), from.max(to));
            match what {
                0 => bytes[from] = byte,
                1 => drop(bytes.drain(from..to.min(from + 32))),
                2 => bytes.insert(from, byte),
                3 => bytes.extend_from_within(from..to.min(from + 256)),
                4 => bytes.truncate(to),
                _ => bytes[from] ^= 1 << (byte % 8),
            }
        }
        bytes
    })
}

#[test]
fn no_bytes_make_a_reader_panic_or_hang() {
    let registry = fakes::registry();
    for (name, read) in READERS {
        let seeds = seeds(name);
        let timed = |bytes: &[u8]| {
            let began = Instant::now();
            read(bytes, &registry);
            assert!(began.elapsed() < LONGEST, "{name}: it took {:?}", began.elapsed());
        };
        seeds.iter().for_each(|seed| timed(seed));
        let config = Config {
            cases: cases(name),
            failure_persistence: None,
            rng_seed: RngSeed::Fixed(7),
            ..Config::default()
        };
        let held = TestRunner::new(config).run(&bent(seeds), |bytes| {
            timed(&bytes);
            Ok(())
        });
        if let Err(error) = held {
            panic!("{name}: {error}");
        }
    }
}
