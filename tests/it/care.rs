//! Looking after the store: `cache verify`, `gc`, `du`, `export` and `import`.

use std::io::Write;
use std::path::{Path, PathBuf};

use serde_json::{Value, json};

use crate::cli::WORDS;
use crate::lab::files_below;
use crate::sealed::{Sealed, until};

fn parsed(sealed: &Sealed, args: &str) -> Value {
    let ended = sealed.run(args);
    serde_json::from_str(&ended.stdout).unwrap_or_else(|error| panic!("{args}: {error}: {ended:?}"))
}

/// The file of a stage's first output.
fn blob(sealed: &Sealed, stage: &str) -> PathBuf {
    let shown = parsed(sealed, &format!("show p.yaml {stage} --json"));
    shown[0]["outputs"][0]["path"].as_str().unwrap().into()
}

fn overwrite(path: &Path, bytes: &[u8]) {
    std::fs::remove_file(path).unwrap();
    std::fs::write(path, bytes).unwrap();
}

fn contents(sealed: &Sealed, below: &str) -> Vec<String> {
    files_below(&sealed.path("cache")).into_iter().filter(|path| path.starts_with(below)).collect()
}

#[test]
fn a_cache_that_does_not_exist_is_named_and_not_called_sound() {
    let sealed = Sealed::with(WORDS);
    let note = "note: there is no cache in `typo`; `--cache DIR` or DRIL_PIPE_CACHE names another one\n";
    for (command, said) in
        [("verify", "nothing to check\n"), ("gc", "removed 0 results"), ("du", "typo: 0 B")]
    {
        let ended = sealed.run(&format!("cache {command} --cache typo"));
        assert_eq!((ended.code, ended.stderr.as_str()), (0, note), "{command}");
        assert!(ended.stdout.starts_with(said), "{}", ended.stdout);
    }
    assert!(!sealed.path("typo").exists());
}

#[test]
fn verify_finds_every_kind_of_damage_and_the_next_run_after_repair_rebuilds_it() {
    let sealed = Sealed::with(WORDS);
    let table = {
        sealed.run_ok("run p.yaml");
        sealed.read("results/words-full/gather.md")
    };
    assert!(sealed.run_ok("cache verify").starts_with("sound: "));
    let wrong = blob(&sealed, "count[word=one]");
    overwrite(&wrong, &vec![b'x'; std::fs::metadata(&wrong).unwrap().len() as usize]);
    let short = blob(&sealed, "gather");
    overwrite(&short, b"cut");
    sealed.write("cache/blobs-v1/ab/stray", "what is this");
    let key = parsed(&sealed, "show p.yaml apart --json")[0]["key"].as_str().unwrap().to_owned();
    overwrite(&sealed.path(&format!("cache/records-v1/{}/{}.json", &key[..2], &key[2..])), b"{");
    let found = parsed(&sealed, "cache verify --json");
    let damage = found["damage"].as_array().unwrap();
    let says = |text: &str| damage.iter().filter(|one| one["what"].as_str().unwrap().contains(text)).count();
    assert_eq!(
        (says("does not match"), says("does not belong"), says("not a valid record")),
        (2, 1, 1),
        "{found}"
    );
    assert_eq!(says("missing or incomplete"), 2, "{found}");
    assert_eq!(sealed.run("cache verify").code, 5);
    assert_eq!(sealed.run("cache verify --repair").code, 0);
    assert_eq!(contents(&sealed, "quarantine-v1").len(), 6, "nothing is deleted");
    assert_eq!(parsed(&sealed, "cache verify --json")["damage"], json!([]));
    let said = sealed.run_ok("run p.yaml");
    assert!(said.contains("done: 3 ran, 5 cached"), "{said}");
    assert_eq!(sealed.read("results/words-full/gather.md"), table);
}

#[test]
fn a_content_of_the_right_length_that_rotted_enters_no_result_after_repair() {
    let sealed = Sealed::with(WORDS);
    sealed.run_ok("run p.yaml");
    let path = blob(&sealed, "say[word=one]");
    let whole = std::fs::read(&path).unwrap();
    let mut rotten = whole.clone();
    rotten[0] ^= 1;
    overwrite(&path, &rotten);
    sealed.run_ok("cache verify --repair");
    sealed.run_ok("run p.yaml");
    assert_eq!(std::fs::read(&path).unwrap(), whole);
}

#[test]
fn gc_removes_what_is_old_or_too_much_and_keeps_what_a_pipeline_or_lock_needs() {
    let sealed = Sealed::with(WORDS);
    sealed.run_ok("run p.yaml --lock");
    sealed.run_ok("run p.yaml --set count.to=9");
    let all = contents(&sealed, "records-v1").len();
    assert_eq!(all, 12);
    let untouched = parsed(&sealed, "cache gc --json");
    assert_eq!(untouched["results"], json!([]), "without a limit only leftovers go");
    for keep in ["p.yaml", "p.lock"] {
        let planned = parsed(&sealed, &format!("cache gc --json --dry-run --older-than 0s --keep {keep}"));
        assert_eq!(planned["results"].as_array().unwrap().len(), 4, "{keep}: {planned}");
        assert_eq!(contents(&sealed, "records-v1").len(), all, "a dry run removes nothing");
    }
    let swept = parsed(&sealed, "cache gc --json --older-than 0s --keep p.yaml");
    assert_eq!(swept["results"].as_array().unwrap().len(), 4);
    assert!(sealed.run_ok("run p.yaml").contains("0 stages executed"));
    sealed.run_ok("cache verify");
    let swept = parsed(&sealed, "cache gc --json --max-size 0B");
    assert_eq!((&swept["left"], contents(&sealed, "blobs-v1").len()), (&json!(0), 0));
    assert!(sealed.run_ok("run p.yaml").contains("done: 8 ran"));
}

#[test]
fn a_limit_without_its_unit_is_refused_and_removes_nothing() {
    let sealed = Sealed::with(WORDS);
    sealed.run_ok("run p.yaml");
    let all = contents(&sealed, "records-v1").len();
    for (limit, expected) in [
        ("--older-than 30", "expected a time with its unit (s, m, h or d)"),
        ("--older-than 1h30", "expected a time with its unit (s, m, h or d)"),
        ("--max-size 20", "expected a size with its unit (B, K, M, G or T)"),
    ] {
        let ended = sealed.run(&format!("cache gc {limit}"));
        assert_eq!(ended.code, 2, "{limit}: {ended:?}");
        assert!(ended.stderr.contains(expected), "{limit}: {}", ended.stderr);
    }
    let ended = sealed.run("run p.yaml --for 90");
    assert!(ended.code == 2 && ended.stderr.contains("with its unit"), "{ended:?}");
    assert_eq!(contents(&sealed, "records-v1").len(), all);
}

#[test]
fn what_was_used_least_recently_goes_first() {
    let sealed = Sealed::with(WORDS);
    sealed.run_ok("run p.yaml --set count.to=9");
    std::thread::sleep(std::time::Duration::from_millis(20));
    sealed.run_ok("run p.yaml");
    let bytes = |below: &str| -> u64 {
        let sizes = contents(&sealed, below).into_iter();
        sizes.map(|path| std::fs::metadata(sealed.path("cache").join(path)).unwrap().len()).sum()
    };
    let first = format!("runs-v1/{}", sealed.list("cache/runs-v1")[0]);
    let all = bytes("blobs-v1") + bytes("records-v1") + bytes("runs-v1");
    let swept = parsed(&sealed, &format!("cache gc --json --max-size {}B", all - bytes(&first) - 1));
    assert_eq!((&swept["runs"], swept["results"].as_array().unwrap().len()), (&json!(1), 1), "{swept}");
    assert!(
        sealed.run_ok("run p.yaml").contains("0 stages executed"),
        "what the last run used is still there"
    );
}

#[test]
fn the_size_of_a_cache_includes_logs_checkpoints_and_files_from_outside() {
    let swept = |shell: &str, code: i32| {
        let sealed = Sealed::with(&format!(
            "name: p\nstages:\n  s:\n    kind: command\n    with: {{ shell: '{shell}', outputs: {{ o: o }}, inputs: {{ f: {{}} }} }}\n    \
             inputs: {{ f: {{ file: f }} }}\n"
        ));
        sealed.write("f", &if shell.contains("wc") { "x".repeat(300_000) } else { String::new() });
        assert_eq!(sealed.run("run p.yaml").code, code);
        let none = parsed(&sealed, "cache gc --json --max-size 1M");
        assert_eq!((&none["freed"], &none["too_much"]), (&json!(0), &json!(false)), "{shell}");
        let swept = parsed(&sealed, "cache gc --json --max-size 100K");
        assert!(swept["freed"].as_u64() > Some(200_000) && swept["too_much"] == false, "{shell}: {swept}");
        [
            swept["results"].as_array().unwrap().len() as u64,
            swept["runs"].as_u64().unwrap(),
            swept["checkpoints"].as_u64().unwrap(),
        ]
    };
    assert_eq!(swept("seq 1 60000; : > {outputs.o}", 0), [0, 1, 0], "a log");
    assert_eq!(swept("seq 1 60000 > {checkpoints}/s; sleep 0.1; exit 1", 1), [0, 0, 1], "a checkpoint");
    assert_eq!(swept("wc -c < {inputs.f} > {outputs.o}", 0), [1, 1, 0], "an input");
}

#[test]
fn gc_takes_nothing_from_a_run_that_goes_on() {
    let sealed = Sealed::with(WORDS);
    sealed.run_ok("run p.yaml");
    let slow = "run p.yaml --json --jobs 1 --set gather.keep=3 --set apart.text=new --set apart.cost=0.001";
    let hang = "--set count.to=40 --set count.step_millis=20";
    let mut child =
        sealed.command(&format!("{slow} {hang}")).stdout(std::process::Stdio::piped()).spawn().unwrap();
    until("it runs", || parsed(&sealed, "runs --json")[0]["state"] == "running");
    let mut taken = 0;
    while child.try_wait().unwrap().is_none() {
        let swept = parsed(&sealed, "cache gc --json --older-than 0s --max-size 0B");
        taken += swept["results"].as_array().unwrap().len();
    }
    let ended = child.wait_with_output().unwrap();
    let said = String::from_utf8(ended.stdout).unwrap();
    assert_eq!(ended.status.code(), Some(0), "{said}");
    assert!(taken >= 4, "what no run uses went: {taken}");
    assert!(said.contains("\"ran\":5"), "{said}");
}

#[test]
fn du_shows_disk_usage_by_folder_and_stage() {
    let sealed = Sealed::with(WORDS);
    sealed.run_ok("run p.yaml");
    let du = parsed(&sealed, "cache du --json");
    let count = du["stages"].as_array().unwrap().iter().find(|one| one["stage"] == "count").unwrap();
    assert_eq!((&count["records"], &count["kind"]), (&json!(3), &json!("count")));
    assert!(sealed.run_ok("cache du").contains("by stage:"));
    assert_eq!(du["unnamed"]["files"], 0);
}

#[test]
fn an_exported_run_refills_a_store_elsewhere_and_nothing_runs_there() {
    let sealed = Sealed::with(WORDS);
    sealed.run_ok("run p.yaml");
    let said = sealed.run_ok("cache export last --out run.zip");
    assert!(said.starts_with("run.zip: run "), "{said}");
    let summary = sealed.run_ok("cache export last --out again.zip --json");
    let summary: Value = serde_json::from_str(&summary).unwrap();
    assert_eq!(summary["archive"], "again.zip");
    assert!(summary["results"].as_u64() > Some(0) && summary["bytes"].as_u64() > Some(0), "{summary}");
    assert_eq!(
        std::fs::read(sealed.path("run.zip")).unwrap(),
        std::fs::read(sealed.path("again.zip")).unwrap()
    );
    let taken = parsed(&sealed, "cache import run.zip --cache other --json");
    assert_eq!((&taken["results"], &taken["refused"]), (&json!(8), &json!([])));
    let said = sealed.run_ok("run p.yaml --cache other --out elsewhere");
    assert!(said.contains("0 stages executed, all 8 cached"), "{said}");
    assert_eq!(sealed.read("elsewhere/gather.md"), sealed.read("results/words-full/gather.md"));
    assert_eq!(parsed(&sealed, "cache import run.zip --cache other --json")["known"], 8);
}

#[test]
fn an_archive_describes_itself_as_a_workflow_run_crate() {
    let sealed = Sealed::with(WORDS);
    sealed.run_ok("run p.yaml");
    sealed.run_ok("cache export last -o run.zip");
    let mut archive = zip::ZipArchive::new(std::fs::File::open(sealed.path("run.zip")).unwrap()).unwrap();
    let document: Value =
        serde_json::from_reader(archive.by_name("ro-crate-metadata.json").unwrap()).unwrap();
    let graph = document["@graph"].as_array().unwrap();
    let entity = |id: &str| graph.iter().find(|one| one["@id"] == id).unwrap_or_else(|| panic!("no {id}"));
    let root = entity("./");
    assert_eq!(root["mainEntity"]["@id"], "pipeline.yaml");
    let profiles = root["conformsTo"].to_string();
    assert!(profiles.contains("/wfrun/workflow/") && profiles.contains("/wfrun/process/"), "{profiles}");
    assert_eq!(entity("#run")["instrument"]["@id"], "pipeline.yaml");
    let actions = graph.iter().filter(|one| one["@type"] == "CreateAction").count();
    assert_eq!(actions, 9, "one for each stage, one for the run");
    let run = entity("#run");
    assert_eq!(run["actionStatus"], "http://schema.org/CompletedActionStatus");
    assert!(run["endTime"].as_str().is_some_and(|time| time.ends_with("+00:00")), "{run}");
    assert!(entity("pipeline.yaml")["conformsTo"]["@id"].as_str().unwrap().contains("ComputationalWorkflow"));
    // Whatever is named is described, and every part is in the archive.
    fn named(value: &Value, into: &mut Vec<String>) {
        match value {
            Value::Object(map) if map.len() == 1 && map.contains_key("@id") => {
                into.push(map["@id"].as_str().unwrap().to_owned());
            }
            Value::Object(map) => map.values().for_each(|value| named(value, into)),
            Value::Array(list) => list.iter().for_each(|value| named(value, into)),
            _ => {}
        }
    }
    let mut ids = Vec::new();
    graph.iter().for_each(|one| named(one, &mut ids));
    for id in ids.iter().filter(|id| !id.starts_with("http")) {
        entity(id);
    }
    for part in root["hasPart"].as_array().unwrap() {
        archive.by_name(part["@id"].as_str().unwrap()).unwrap();
    }
}

#[test]
fn an_archive_has_the_pipeline_file_with_all_that_it_includes() {
    let sealed = Sealed::new();
    let (stages, shared) = WORDS.split_once("profiles:").unwrap();
    let (head, stages) = stages.split_once("stages:").unwrap();
    sealed.write("exp/p.yaml", &format!("{head}include: [parts/stages.yaml, ../shared/profiles.yaml]\n"));
    sealed.write("exp/parts/stages.yaml", &format!("stages:{stages}"));
    sealed.write("shared/profiles.yaml", &format!("profiles:{shared}"));
    sealed.run_ok("run exp/p.yaml --out results");
    // What is in the archive is what was read.
    sealed.write("exp/parts/stages.yaml", "stages: [\n");
    sealed.run_ok("cache export last -o run.zip");
    let mut archive = zip::ZipArchive::new(std::fs::File::open(sealed.path("run.zip")).unwrap()).unwrap();
    let document: Value =
        serde_json::from_reader(archive.by_name("ro-crate-metadata.json").unwrap()).unwrap();
    let entity = |id: &str| {
        document["@graph"].as_array().unwrap().iter().find(|one| one["@id"] == id).unwrap().clone()
    };
    assert_eq!(entity("./")["mainEntity"]["@id"], "pipeline/exp/p.yaml");
    assert_eq!(entity("pipeline/exp/p.yaml")["hasPart"].as_array().unwrap().len(), 2);
    let other = Sealed::new();
    for name in ["pipeline/exp/p.yaml", "pipeline/exp/parts/stages.yaml", "pipeline/shared/profiles.yaml"] {
        entity(name);
        let text = std::io::read_to_string(archive.by_name(name).unwrap()).unwrap();
        other.write(name, &text);
    }
    std::fs::copy(sealed.path("run.zip"), other.path("run.zip")).unwrap();
    other.run_ok("cache import run.zip");
    assert!(other.run_ok("run pipeline/exp/p.yaml").contains("0 stages executed, all 8 cached"));
}

/// The archive at `path` with its entries changed by `edit`; `None` drops one.
fn edited(path: &Path, edit: impl Fn(&str, Vec<u8>) -> Option<(String, Vec<u8>)>) -> Vec<u8> {
    let mut archive = zip::ZipArchive::new(std::fs::File::open(path).unwrap()).unwrap();
    let mut writer = zip::ZipWriter::new(std::io::Cursor::new(Vec::new()));
    for at in 0..archive.len() {
        let mut entry = archive.by_index(at).unwrap();
        let name = entry.name().unwrap().into_owned();
        let mut bytes = Vec::new();
        std::io::Read::read_to_end(&mut entry, &mut bytes).unwrap();
        if let Some((name, bytes)) = edit(&name, bytes) {
            let options =
                zip::write::SimpleFileOptions::default().compression_method(zip::CompressionMethod::Stored);
            writer.start_file(&*name, options).unwrap();
            writer.write_all(&bytes).unwrap();
        }
    }
    writer.finish().unwrap().into_inner()
}

#[test]
fn an_import_believes_nothing_that_it_has_not_hashed() {
    let sealed = Sealed::with(WORDS);
    sealed.run_ok("run p.yaml");
    sealed.run_ok("cache export last -o run.zip");
    let path = sealed.path("run.zip");
    let forged: [(&str, Vec<u8>); 4] = [
        (
            "does not match its name",
            edited(&path, |name, mut bytes| {
                if name.starts_with("blobs/") {
                    bytes.push(b'!');
                }
                Some((name.to_owned(), bytes))
            }),
        ),
        (
            "its key does not match its name",
            edited(&path, |name, bytes| {
                let text = String::from_utf8_lossy(&bytes).replace("\"revision\":1", "\"revision\":7");
                Some((name.to_owned(), if name.starts_with("records/") { text.into_bytes() } else { bytes }))
            }),
        ),
        (
            "neither in the archive nor in the store",
            edited(&path, |name, bytes| (!name.starts_with("blobs/")).then(|| (name.to_owned(), bytes))),
        ),
        (
            "it is not a valid record",
            edited(&path, |name, bytes| {
                Some((
                    name.to_owned(),
                    if name.starts_with("records/") { bytes[..9].to_vec() } else { bytes },
                ))
            }),
        ),
    ];
    for (number, (why, bytes)) in forged.into_iter().enumerate() {
        std::fs::write(sealed.path("forged.zip"), bytes).unwrap();
        let ended = sealed.run(&format!("cache import forged.zip --cache other{number}"));
        assert_eq!(ended.code, 5, "{why}: {ended:?}");
        assert!(ended.stderr.contains(why), "{why}: {}", ended.stderr);
        assert!(ended.stdout.starts_with("imported 0 results"), "{why}: {}", ended.stdout);
        sealed.run_ok(&format!("cache verify --cache other{number}"));
    }
}

#[test]
fn no_name_in_an_archive_becomes_a_path() {
    let sealed = Sealed::with(WORDS);
    sealed.run_ok("run p.yaml");
    sealed.run_ok("cache export last -o run.zip");
    let hostile = edited(&sealed.path("run.zip"), |name, bytes| {
        let name = match name {
            name if name.starts_with("logs/") => format!("../../escaped-{}", name.replace('/', "-")),
            "pipeline.yaml" => "/tmp/escaped-from-an-archive".to_owned(),
            "run/run.json" => "records/../../escaped.json".to_owned(),
            "run/events.jsonl" => "blobs/../../escaped".to_owned(),
            name => name.to_owned(),
        };
        Some((name, bytes))
    });
    std::fs::write(sealed.path("hostile.zip"), hostile).unwrap();
    let before = sealed.list(".");
    let ended = sealed.run("cache import hostile.zip --cache cache");
    assert!(ended.stderr.contains("its name is not a key"), "{ended:?}");
    assert_eq!(sealed.list("."), before);
    assert!(!Path::new("/tmp/escaped-from-an-archive").exists());
    assert!(files_below(&sealed.path("cache")).iter().all(|path| !path.contains("escaped")));
}

#[test]
fn an_archive_that_is_cut_off_or_none_at_all_is_an_error_that_names_it() {
    let sealed = Sealed::with(WORDS);
    sealed.run_ok("run p.yaml");
    sealed.run_ok("cache export last -o run.zip");
    let whole = std::fs::read(sealed.path("run.zip")).unwrap();
    for bytes in [&whole[..whole.len() / 2], b"", b"PK\x05\x06"] {
        std::fs::write(sealed.path("cut.zip"), bytes).unwrap();
        let ended = sealed.run("cache import cut.zip --cache other");
        assert_eq!(ended.code, 4, "{ended:?}");
        assert!(ended.stderr.contains("cut.zip"), "{}", ended.stderr);
    }
    let ended = sealed.run("cache export 1999");
    assert_eq!(ended.code, 2, "{ended:?}");
}

#[test]
fn a_run_that_failed_cannot_be_exported_and_the_error_names_the_stage() {
    let sealed = Sealed::with(WORDS);
    sealed.run("run p.yaml --set count.mishap=fail");
    let ended = sealed.run("cache export last");
    assert_eq!(ended.code, 4, "{ended:?}");
    assert!(ended.stderr.contains("`count[word=one]` was failed in this run"), "{}", ended.stderr);
}
