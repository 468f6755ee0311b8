//! Files and folders from outside: known by content, not read again while they are unchanged, and checked where that is asked for.

use std::time::Duration;

use crate::sealed::Sealed;

const TABLE: &str = "\
name: p
stages:
  data: { kind: import, with: { path: data.csv } }
  copy:
    kind: command
    with: { shell: \"cat {inputs.d} > o\", outputs: { o: { type: table, path: o } } }
    inputs: { d: data }
";

#[test]
fn an_edit_of_the_file_runs_what_reads_it_and_a_touch_does_not() {
    let sealed = Sealed::with(TABLE);
    sealed.write("data.csv", "1\n");
    assert!(sealed.run_ok("run p.yaml").contains("2 ran"));
    assert_eq!(sealed.read("results/p-default/copy.csv"), "1\n");
    sealed.write("data.csv", "1\n");
    assert!(sealed.run_ok("run p.yaml").contains("all 2 cached"));
    sealed.write("data.csv", "2\n");
    let planned = sealed.run_ok("plan p.yaml");
    assert!(planned.contains("data") && planned.contains("copy  depends on"), "{planned}");
    assert!(sealed.run_ok("run p.yaml").contains("2 ran"));
    assert_eq!(sealed.read("results/p-default/copy.csv"), "2\n");
}

const FOLDER: &str = "\
name: p
stages:
  data: { kind: import, with: { path: raw/ } }
  list:
    kind: command
    with: { shell: \"cd {inputs.d}/; find . -type f | sort | xargs cat > $$OLDPWD/o\", outputs: { o: { type: table, path: o } } }
    inputs: { d: data }
";

#[test]
fn a_folder_is_its_files_and_their_names() {
    let sealed = Sealed::with(FOLDER);
    sealed.write("raw/a", "1\n");
    sealed.write("raw/sub/b", "2\n");
    std::os::unix::fs::symlink("../a", sealed.path("raw/sub/c")).unwrap();
    assert!(sealed.run_ok("run p.yaml").contains("2 ran"));
    assert_eq!(sealed.read("results/p-default/list.csv"), "1\n2\n1\n", "links to files are followed");
    assert!(sealed.run_ok("run p.yaml").contains("all 2 cached"));
    sealed.write("raw/sub/d", "3\n");
    assert!(sealed.run_ok("run p.yaml").contains("2 ran"));
    std::os::unix::fs::symlink("..", sealed.path("raw/up")).unwrap();
    let ended = sealed.run("plan p.yaml");
    assert_eq!(ended.code, 3);
    assert!(ended.stderr.contains("raw/up") && ended.stderr.contains("a folder outside"), "{}", ended.stderr);
}

#[test]
fn a_folder_in_place_of_a_file_and_the_reverse_are_reported_with_their_line() {
    let sealed = Sealed::with(TABLE);
    std::fs::create_dir(sealed.path("data.csv")).unwrap();
    let said = sealed.run("plan p.yaml").stderr;
    assert!(said.contains("p.yaml:3:") && said.contains("it is a folder, expected a file"), "{said}");
    let sealed = Sealed::with(FOLDER);
    sealed.write("raw", "x");
    assert!(sealed.run("plan p.yaml").stderr.contains("expected a folder"));
    let sealed = Sealed::with(FOLDER);
    let said = sealed.run("plan p.yaml");
    assert!(said.code == 3 && said.stderr.contains("raw"), "{said:?}");
}

/// Makes a file executable, or not.
fn chmod(sealed: &Sealed, name: &str, mode: u32) {
    use std::os::unix::fs::PermissionsExt;
    std::fs::set_permissions(sealed.path(name), std::fs::Permissions::from_mode(mode)).unwrap();
}

const PROGRAM: &str = "\
name: p
stages:
  tool: { kind: import, with: { path: tool.sh } }
  use:
    kind: command
    with: { shell: \"if test -x {inputs.t}; then echo yes; else echo no; fi > o\", outputs: { o: { type: table, path: o } } }
    inputs: { t: tool }
";

#[test]
fn the_executable_bit_of_an_imported_file_reaches_what_reads_it() {
    let sealed = Sealed::with(PROGRAM);
    sealed.write("tool.sh", "#!/bin/sh\n");
    sealed.run_ok("run p.yaml");
    assert_eq!(sealed.read("results/p-default/use.csv"), "no\n");
    chmod(&sealed, "tool.sh", 0o755);
    let planned = sealed.run_ok("plan p.yaml");
    assert!(planned.contains("tool") && planned.contains("may be executed now"), "{planned}");
    assert!(sealed.run_ok("run p.yaml").contains("2 ran"));
    assert_eq!(sealed.read("results/p-default/use.csv"), "yes\n");
    chmod(&sealed, "tool.sh", 0o644);
    assert!(sealed.run_ok("run p.yaml").contains("all 2 cached"));
    assert_eq!(sealed.read("results/p-default/use.csv"), "no\n");
}

#[test]
fn a_record_of_an_import_without_the_executable_bit_in_its_key_is_not_used() {
    let sealed = Sealed::with(PROGRAM);
    sealed.write("tool.sh", "#!/bin/sh\n");
    sealed.run_ok("run p.yaml tool");
    // As earlier versions wrote it where the file was executable: under the key of a file that is not.
    let records = crate::lab::files_below(&sealed.path("cache/records-v1"));
    let [record] = records.as_slice() else { panic!("{records:?}") };
    let path = format!("cache/records-v1/{record}");
    let mut json: serde_json::Value = serde_json::from_str(&sealed.read(&path)).unwrap();
    json["outputs"]["content"]["executable"] = true.into();
    sealed.write(&path, &json.to_string());
    for folder in ["history-v1", "settled-v1"] {
        let _ = std::fs::remove_dir_all(sealed.path(&format!("cache/{folder}")));
    }
    sealed.run_ok("run p.yaml");
    assert_eq!(sealed.read("results/p-default/use.csv"), "no\n");
    assert!(sealed.run_ok("run p.yaml").contains("all 2 cached"), "the record is replaced");
}

#[test]
fn a_folder_named_as_a_file_is_reported_also_beside_its_import() {
    let sealed = Sealed::with(
        "name: p\nstages:\n  data: { kind: import, with: { path: raw/, exclude: [] } }\n  \
         a: { kind: concat, inputs: { parts: { file: raw } } }\n",
    );
    sealed.write("raw/x", "1");
    let ended = sealed.run("plan p.yaml");
    assert_eq!(ended.code, 3, "{ended:?}");
    let said = ended.stderr;
    assert!(said.contains("p.yaml:4:") && said.contains("it is a folder, expected a file"), "{said}");
}

#[test]
fn a_content_that_must_be_so_and_is_not_stops_everything_beforehand() {
    let digest = "f4f1b1b4a3ea7d3c0ad5ac2ff6a1a6dc0f9d9c4dd3e6b1cc3a0a5a3d5f7b1e2c";
    let with = TABLE.replace("path: data.csv", &format!("path: data.csv, blake3: {digest}"));
    let sealed = Sealed::with(&with);
    sealed.write("data.csv", "1\n");
    let ended = sealed.run("run p.yaml");
    assert_eq!(ended.code, 3);
    let right = blake3::hash(b"1\n").to_hex();
    assert!(ended.stderr.contains(&format!("its content is {right}, expected {digest}")), "{}", ended.stderr);
    assert!(!sealed.path("cache").exists(), "nothing ran");
    sealed.write("p.yaml", &with.replace(digest, &right));
    assert!(sealed.run_ok("run p.yaml").contains("2 ran"));
}

#[test]
fn a_folder_at_rest_is_not_read_again() {
    let sealed = Sealed::with(FOLDER);
    for number in 0..80 {
        sealed.write(&format!("raw/{number}"), &number.to_string());
    }
    std::thread::sleep(Duration::from_millis(2_300));
    sealed.run_ok("run p.yaml");
    let notes = sealed.read("cache/stats-v1/outside.jsonl");
    assert_eq!(notes.lines().count(), 80);
    // A note is believed: with another digest in it, the folder is taken for another.
    let other = blake3::hash(b"other").to_hex();
    let own = blake3::hash(b"7").to_hex();
    std::fs::write(sealed.path("cache/stats-v1/outside.jsonl"), notes.replace(&*own, &other)).unwrap();
    assert!(!sealed.run_ok("plan p.yaml").contains("nothing to run"));
    // And a file that was touched is read, whatever its note says.
    sealed.write("raw/7", "7");
    assert!(sealed.run_ok("plan p.yaml").contains("nothing to run"));
}
