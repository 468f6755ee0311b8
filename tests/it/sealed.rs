//! A place for one test: a folder of its own, an empty environment, and the program with the fakes as its stage kinds.

use std::path::{Path, PathBuf};
use std::process::{Child, Command, Stdio};
use std::time::{Duration, Instant};

use serde_json::Value;

/// The place.
pub struct Sealed {
    folder: tempfile::TempDir,
}

/// What a finished program left.
#[derive(Debug)]
pub struct Ended {
    /// Standard output.
    pub stdout: String,
    /// Standard error.
    pub stderr: String,
    /// The exit code; -1 where a signal ended it.
    pub code: i32,
}

impl Sealed {
    /// An empty one.
    pub fn new() -> Self {
        Self { folder: tempfile::tempdir().unwrap() }
    }

    /// One with a pipeline file `p.yaml`.
    pub fn with(pipeline: &str) -> Self {
        let sealed = Self::new();
        sealed.write("p.yaml", pipeline);
        sealed
    }

    /// A path in it.
    pub fn path(&self, name: &str) -> PathBuf {
        self.folder.path().join(name)
    }

    /// Writes a file, with the folders above it.
    pub fn write(&self, name: &str, text: &str) {
        let path = self.path(name);
        std::fs::create_dir_all(path.parent().unwrap()).unwrap();
        std::fs::write(path, text).unwrap();
    }

    /// Reads a file.
    pub fn read(&self, name: &str) -> String {
        std::fs::read_to_string(self.path(name)).unwrap_or_else(|error| panic!("{name}: {error}"))
    }

    /// The names in a folder, sorted; empty where there is none.
    pub fn list(&self, name: &str) -> Vec<String> {
        let Ok(entries) = std::fs::read_dir(self.path(name)) else { return Vec::new() };
        let mut names: Vec<String> =
            entries.map(|entry| entry.unwrap().file_name().into_string().unwrap()).collect();
        names.sort();
        names
    }

    /// The program with these arguments, split at spaces.
    pub fn command(&self, args: &str) -> Command {
        let mut command = Command::new(program());
        command.args(args.split(' ')).current_dir(self.folder.path()).env_clear().stdin(Stdio::null());
        command
    }

    /// Runs the program to its end.
    pub fn run(&self, args: &str) -> Ended {
        ended(self.command(args))
    }

    /// As [`Self::run`], and it must exit with 0.
    pub fn run_ok(&self, args: &str) -> String {
        let ended = self.run(args);
        assert_eq!(ended.code, 0, "{args}: {ended:?}");
        ended.stdout
    }

    /// The events of a `run --json`, each line parsed.
    pub fn events(&self, args: &str) -> Vec<Value> {
        lines(&self.run(&format!("run p.yaml --json {args}")).stdout)
    }

    /// What differs from run to run or from machine to machine, replaced by names in brackets.
    pub fn normal(&self, text: &str) -> String {
        let folder = self.folder.path().canonicalize().unwrap();
        let text = text.replace(&*folder.to_string_lossy(), "[folder]");
        let text = text.replace(&*self.folder.path().to_string_lossy(), "[folder]");
        let text = replace(&text, " s\n", "[time]", |c| c.is_ascii_digit() || c == '.');
        replace(&text, " threads\n", "[n]", |c| c.is_ascii_digit())
    }
}

/// Runs a command to its end.
pub fn ended(mut command: Command) -> Ended {
    let output = command.output().unwrap();
    Ended {
        stdout: String::from_utf8(output.stdout).unwrap(),
        stderr: String::from_utf8(output.stderr).unwrap(),
        code: output.status.code().unwrap_or(-1),
    }
}

/// Each line as JSON.
pub fn lines(text: &str) -> Vec<Value> {
    let parse = |line| serde_json::from_str(line).unwrap_or_else(|error| panic!("{error}: {line}"));
    text.lines().map(parse).collect()
}

/// Waits until something is true; fails after 20 s.
pub fn until(what: &str, mut is_true: impl FnMut() -> bool) {
    let began = Instant::now();
    while !is_true() {
        assert!(began.elapsed() < Duration::from_secs(20), "waited too long until {what}");
        std::thread::sleep(Duration::from_millis(5));
    }
}

/// Sends a signal to a child by its number's name: `INT`, `TERM`, `KILL`.
pub fn signal(child: &Child, name: &str) {
    let status = Command::new("kill").args([&format!("-{name}"), &child.id().to_string()]).status().unwrap();
    assert!(status.success());
}

/// The program under test: an example of this package, built beside this test.
pub fn program() -> PathBuf {
    let test = std::env::current_exe().unwrap();
    let program = test.ancestors().nth(2).map(|folder: &Path| folder.join("examples/fakes")).unwrap();
    assert!(
        program.is_file(),
        "`cargo test` builds {} too; `cargo test --test it` does not",
        program.display()
    );
    program
}

/// Replaces the run of characters that `is_part` accepts before every `end` by `name`.
fn replace(text: &str, end: &str, name: &str, is_part: impl Fn(char) -> bool) -> String {
    let mut pieces: Vec<&str> = text.split(end).collect();
    let last = pieces.pop().unwrap_or_default();
    let mut normal = String::new();
    for piece in pieces {
        let kept = piece.trim_end_matches(&is_part);
        normal += kept;
        if kept.len() < piece.len() {
            normal += name;
        }
        normal += end;
    }
    normal + last
}
