//! `tests/bad/` holds one mistake a file; what is said about each is a snapshot.

use std::path::{Path, PathBuf};

use dril_pipe::resolve::{Choices, resolve};
use dril_pipe::spec::{Diagnostics, SourceName, parse_bytes};

use crate::samples;

fn folder() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/bad")
}

/// The options in the first line of a file, as in `# args: --profile fast --set a.b=1`.
fn choices(bytes: &[u8]) -> Choices {
    let text = String::from_utf8_lossy(bytes);
    let line = text.lines().next().and_then(|line| line.strip_prefix("# args: ")).unwrap_or_default();
    let words: Vec<&str> = line.split_whitespace().collect();
    let mut choices = Choices::default();
    for pair in words.chunks(2) {
        match pair {
            ["--profile", profile] => choices.profile = Some((*profile).to_owned()),
            ["--set", set] => choices.set.push((*set).to_owned()),
            other => panic!("unknown option {other:?}"),
        }
    }
    choices
}

fn said(path: &Path) -> Result<(), Diagnostics> {
    let bytes = std::fs::read(path).unwrap();
    let name = SourceName(format!("tests/bad/{}", path.file_name().unwrap().to_string_lossy()));
    let spec = parse_bytes(&bytes, &name)?;
    resolve(&spec, &choices(&bytes), &samples::registry()).map(|_| ())
}

#[test]
fn every_mistake_is_explained() {
    let mut files: Vec<PathBuf> =
        std::fs::read_dir(folder()).unwrap().map(|entry| entry.unwrap().path()).collect();
    files.sort();
    assert!(files.len() > 90);
    for file in files {
        let stem = file.file_stem().unwrap().to_string_lossy().into_owned();
        let said = said(&file).expect_err(&stem).to_string();
        insta::assert_snapshot!(format!("bad__{stem}"), said);
    }
}
