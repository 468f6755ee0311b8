//! `tests/bad/` holds one mistake a file; what the program says about each is a snapshot.

use std::path::{Path, PathBuf};

use crate::sealed::Sealed;

fn root() -> &'static Path {
    Path::new(env!("CARGO_MANIFEST_DIR"))
}

/// The options in the first line of a file, as in `# args: --profile fast --set a.b=1`.
fn options(file: &Path) -> String {
    let bytes = std::fs::read(file).unwrap();
    let text = String::from_utf8_lossy(&bytes);
    let line = text.lines().next().and_then(|line| line.strip_prefix("# args:"));
    line.unwrap_or_default().to_owned()
}

/// Exit code and standard error of `dril-pipe graph` for a path below the project folder.
fn said(path: &str, options: &str) -> String {
    let mut command = Sealed::new().command(&format!("graph {path}{options}"));
    let output = command.current_dir(root()).env("DRIL_FAKES_KINDS", "samples").output().unwrap();
    assert!(output.stdout.is_empty(), "{path}");
    format!("exit code {}\n{}", output.status.code().unwrap(), String::from_utf8(output.stderr).unwrap())
}

#[test]
fn every_mistake_is_explained() {
    let entries = std::fs::read_dir(root().join("tests/bad")).unwrap();
    let mut files: Vec<PathBuf> = entries.map(|entry| entry.unwrap().path()).collect();
    files.sort();
    assert!(files.len() > 90);
    for file in files {
        let stem = file.file_stem().unwrap().to_str().unwrap();
        insta::assert_snapshot!(
            format!("bad__{stem}"),
            said(&format!("tests/bad/{stem}.yaml"), &options(&file))
        );
    }
}

#[test]
fn a_folder_and_a_missing_file_are_explained() {
    insta::assert_snapshot!("bad__folder", said("tests/bad", ""));
    insta::assert_snapshot!("bad__missing_file", said("tests/bad/nowhere.yaml", ""));
}
