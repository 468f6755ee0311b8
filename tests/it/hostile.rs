//! A hostile world: full disks, stores that can only be read, rights that are missing, links, clocks that jump, names
//! that nobody expects. Everything works, or stops with an error that says what to do; nothing gives a wrong result.

use std::os::unix::ffi::OsStrExt;
use std::os::unix::fs::{PermissionsExt, symlink};
use std::path::Path;
use std::time::{Duration, SystemTime};

use dril_pipe::store::Digest;
use serde_json::json;

use crate::cli::WORDS;
use crate::lab::{Lab, files_below};
use crate::scenario::StageLine;
use crate::sealed::{Ended, Sealed, ended};

fn stages() -> Vec<StageLine> {
    vec![
        StageLine::new("a", "emit", json!({"text": "start\n"})),
        StageLine::new("b", "count", json!({"to": 3})).reads("start", &["a"]),
        StageLine::new("c", "concat", json!({})).reads("parts", &["b"]).reads_file("parts", "data.txt"),
    ]
}

fn lab() -> Lab {
    let lab = Lab::new();
    lab.file("data.txt", "from outside");
    lab
}

/// Every content is what its name says.
fn sound(store: &Path) {
    if !store.is_dir() {
        return;
    }
    for path in files_below(store).iter().filter(|path| path.starts_with("blobs-v1/")) {
        let bytes = std::fs::read(store.join(path)).unwrap();
        assert_eq!(path["blobs-v1/".len()..].replace('/', ""), Digest::of(&bytes).hex());
    }
}

#[test]
fn a_disk_that_is_full_from_any_step_on_costs_the_run_and_no_result() {
    let expected = lab().run(&stages()).executed.outputs;
    let lab = lab();
    let mut failures = 0;
    for nth in (1..400).step_by(if cfg!(debug_assertions) { 3 } else { 1 }) {
        let mut engine = lab.engine(&stages(), 2);
        engine.env("DRIL_FAKES_FULL_AT", nth.to_string());
        let status = engine.status().unwrap();
        sound(lab.store.root());
        match status.code() {
            Some(0) => break,
            Some(1 | 4) => failures += 1,
            other => panic!("step {nth}: {other:?}"),
        }
    }
    assert!(failures > 5, "the disk was full {failures} times");
    let after = lab.run(&stages());
    assert!(after.executed.outcome.is_complete(), "{}", after.error());
    assert_eq!(after.executed.outputs, expected);
}

#[test]
fn a_full_disk_is_named_in_the_error() {
    let lab = lab();
    let mut engine = lab.engine(&stages(), 1);
    engine.env("DRIL_FAKES_FULL_AT", "2").stdout(std::process::Stdio::piped());
    let said = String::from_utf8(engine.output().unwrap().stdout).unwrap();
    assert!(said.contains("No space left on device") && said.contains("cannot write `"), "{said}");
}

/// Runs as a user without rights of its own; `None` where that cannot be had.
fn as_nobody(sealed: &Sealed, args: &str) -> Option<Ended> {
    if !rustix::process::geteuid().is_root() {
        return Some(sealed.run(args));
    }
    let program = crate::sealed::program();
    let has = |tool: &str| std::process::Command::new(tool).arg("--version").output().is_ok();
    // The program has to be where that user can reach it.
    let reachable = sealed.path("program");
    std::fs::copy(program, &reachable).ok()?;
    std::fs::set_permissions(sealed.path("."), std::fs::Permissions::from_mode(0o777)).ok()?;
    if !has("setpriv") {
        return None;
    }
    let mut command = std::process::Command::new("setpriv");
    command.args(["--reuid=65534", "--regid=65534", "--clear-groups", "--inh-caps=-all"]).arg(&reachable);
    command
        .args(args.split(' '))
        .current_dir(sealed.path("."))
        .env_clear()
        .stdin(std::process::Stdio::null());
    Some(ended(command))
}

fn read_only(path: &Path, yes: bool) {
    for name in files_below(path) {
        let folder = path.join(name).parent().unwrap().to_owned();
        std::fs::set_permissions(&folder, std::fs::Permissions::from_mode(if yes { 0o555 } else { 0o777 }))
            .unwrap();
    }
    std::fs::set_permissions(path, std::fs::Permissions::from_mode(if yes { 0o555 } else { 0o777 })).unwrap();
}

#[test]
fn a_store_that_can_only_be_read_serves_what_it_has_and_says_what_it_lacks() {
    let sealed = Sealed::with(WORDS);
    sealed.run_ok("run p.yaml");
    read_only(&sealed.path("cache"), true);
    let cached = as_nobody(&sealed, "run p.yaml --out mine");
    let stale = as_nobody(&sealed, "run p.yaml --out mine --set count.to=7");
    let looked = as_nobody(&sealed, "status p.yaml");
    read_only(&sealed.path("cache"), false);
    let Some(cached) = cached else { return };
    assert_eq!(cached.code, 0, "{cached:?}");
    assert!(cached.stdout.contains("0 stages executed"), "{}", cached.stdout);
    let stale = stale.unwrap();
    assert_eq!(stale.code, 4, "{stale:?}");
    assert!(
        stale.stderr.contains("Permission denied") && stale.stderr.contains("--cache DIR"),
        "{}",
        stale.stderr
    );
    assert_eq!(looked.unwrap().code, 0);
}

#[test]
fn a_record_or_content_that_may_not_be_read_is_an_error_and_no_rerun() {
    let sealed = Sealed::with(WORDS);
    sealed.run_ok("run p.yaml");
    let records = sealed.path("cache/records-v1");
    std::fs::remove_dir_all(sealed.path("cache/history-v1")).unwrap();
    for name in files_below(&records) {
        std::fs::set_permissions(records.join(name), std::fs::Permissions::from_mode(0o000)).unwrap();
    }
    let Some(ended) = as_nobody(&sealed, "run p.yaml --out mine") else { return };
    assert_eq!(ended.code, 4, "{ended:?}");
    assert!(
        ended.stderr.contains("cannot read `") && ended.stderr.contains("records-v1"),
        "{}",
        ended.stderr
    );
}

#[test]
fn a_record_whose_content_is_gone_or_cut_runs_its_stage_again() {
    for cut in [false, true] {
        let sealed = Sealed::with(WORDS);
        sealed.run_ok("run p.yaml");
        let table = sealed.read("results/words-full/gather.md");
        for name in files_below(&sealed.path("cache/blobs-v1")) {
            let path = sealed.path("cache/blobs-v1").join(name);
            let bytes = std::fs::read(&path).unwrap();
            std::fs::remove_file(&path).unwrap();
            if cut {
                std::fs::write(&path, &bytes[..bytes.len() / 2]).unwrap();
            }
        }
        std::fs::remove_dir_all(sealed.path("results")).unwrap();
        assert!(sealed.run_ok("run p.yaml").contains("done: 8 ran"));
        assert_eq!(sealed.read("results/words-full/gather.md"), table);
    }
}

#[test]
fn a_clock_that_jumps_changes_no_verdict() {
    let sealed = Sealed::with(WORDS);
    sealed.run_ok("run p.yaml");
    let far = [SystemTime::UNIX_EPOCH, SystemTime::now() + Duration::from_secs(50 * 365 * 86_400)];
    for time in far {
        for name in files_below(&sealed.path("cache")) {
            let file = std::fs::File::open(sealed.path("cache").join(name)).unwrap();
            file.set_modified(time).unwrap();
        }
        let file = std::fs::File::open(sealed.path("p.yaml")).unwrap();
        file.set_modified(time).unwrap();
        assert!(sealed.run_ok("run p.yaml").contains("0 stages executed"));
        for command in
            ["status p.yaml", "explain p.yaml gather", "runs", "cache gc --dry-run --older-than 1d"]
        {
            sealed.run_ok(command);
        }
    }
    assert!(
        sealed.run_ok("status p.yaml").contains("made 0 s ago"),
        "what lies in the future is not negative"
    );
}

#[test]
fn an_output_that_is_a_link_is_refused_and_its_target_stays_as_it_is() {
    let sealed = Sealed::with(WORDS);
    let ended = sealed.run("run p.yaml --set count.mishap=link");
    assert_eq!(ended.code, 1, "{ended:?}");
    assert!(ended.stderr.contains("is a link"), "{}", ended.stderr);
    assert!(std::fs::metadata("/etc/hostname").is_ok_and(|meta| meta.permissions().mode() & 0o200 != 0));
}

#[test]
fn a_link_in_the_store_is_not_followed_out_of_it() {
    let sealed = Sealed::with(WORDS);
    sealed.run_ok("run p.yaml");
    let shown: serde_json::Value = serde_json::from_str(&sealed.run_ok("show p.yaml apart --json")).unwrap();
    let path = shown[0]["outputs"][0]["path"].as_str().unwrap();
    sealed.write("elsewhere", "apart");
    std::fs::remove_file(path).unwrap();
    symlink(sealed.path("elsewhere"), path).unwrap();
    let said = sealed.run_ok("run p.yaml");
    assert!(said.contains("done: 1 ran, 7 cached"), "{said}");
    assert!(std::fs::symlink_metadata(path).unwrap().is_file());
    assert_eq!(sealed.read("elsewhere"), "apart");
}

#[test]
fn a_store_copied_to_another_place_is_as_good_as_the_first() {
    let sealed = Sealed::with(WORDS);
    sealed.run_ok("run p.yaml");
    let status =
        std::process::Command::new("cp").arg("-r").args([sealed.path("cache"), sealed.path("copy")]).status();
    assert!(status.unwrap().success());
    std::fs::remove_dir_all(sealed.path("cache")).unwrap();
    assert!(sealed.run_ok("run p.yaml --cache copy").contains("0 stages executed"));
    assert!(sealed.run_ok("run p.yaml --cache copy --set count.to=3").contains("done: 4 ran, 4 cached"));
}

#[test]
fn a_store_whose_path_is_no_text_is_an_error_that_names_the_way_out() {
    let sealed = Sealed::with(WORDS);
    let mut command = sealed.command("run p.yaml --cache");
    command.arg(std::ffi::OsStr::from_bytes(b"\xff cache"));
    let ended = ended(command);
    assert_eq!(ended.code, 4, "{ended:?}");
    assert!(
        ended.stderr.contains("is not UTF-8") && ended.stderr.contains("--cache DIR"),
        "{}",
        ended.stderr
    );
}

#[test]
fn names_with_spaces_and_newlines_work_everywhere() {
    for name in [&b"with space"[..], b"new\nline", "ünïcode".as_bytes()] {
        let sealed = Sealed::new();
        let folder = sealed.path(".").join(std::ffi::OsStr::from_bytes(name));
        std::fs::create_dir(&folder).unwrap();
        std::fs::write(folder.join("p.yaml"), WORDS).unwrap();
        let run = |args: &[&str]| {
            let mut command = sealed.command("run");
            command.current_dir(&folder).args(args);
            ended(command)
        };
        let first = run(&["p.yaml", "--cache", "the cache", "--out", "the results"]);
        assert_eq!(first.code, 0, "{first:?}");
        assert!(folder.join("the results/gather.md").is_file());
        let absolute = folder.join("p.yaml");
        let mut command = sealed.command("run");
        command.current_dir(sealed.path(".")).arg(&absolute).arg("--cache").arg(folder.join("the cache"));
        let second = ended(command);
        assert!(second.stdout.contains("0 stages executed"), "{second:?}");
        let mut command = sealed.command("cache");
        command
            .current_dir(&folder)
            .args(["export", "last", "--out"])
            .arg(std::ffi::OsStr::from_bytes(b"a \xff.zip"));
        command.args(["--cache", "the cache"]);
        let exported = ended(command);
        assert_eq!(exported.code, 0, "{exported:?}");
    }
}

#[test]
fn a_file_from_outside_with_an_odd_name_is_read_as_it_is() {
    let sealed = Sealed::with(
        "name: x\nstages:\n  a: { kind: concat, inputs: { parts: [{ file: \"a b.txt\" }, { file: \"c\\nd.txt\" }] } }\n",
    );
    sealed.write("a b.txt", "one");
    sealed.write("c\nd.txt", "two");
    sealed.run_ok("run p.yaml");
    assert_eq!(sealed.read("results/x-default/a.md"), "one\ntwo");
    for command in ["status p.yaml", "show p.yaml a", "explain p.yaml a", "graph p.yaml"] {
        let said = sealed.run_ok(command);
        assert!(!said.contains("c\nd"), "a name breaks no line: {said}");
    }
    sealed.run_ok("cache export last -o x.zip");
    sealed.run_ok("cache import x.zip --cache other");
}
