//! `dril-pipe env`: what the environments offer on the command line.

use std::ffi::OsString;
use std::path::Path;

use dril_stage_api::Reply;

use crate::check::{self, CheckError};

/// One line about it, for the list of commands.
pub const ABOUT: &str = "Check the environments against recordings of the originals";

const HELP: &str = "\
Check the environments against recordings of the originals

Usage: dril-pipe env check --traces DIR

Replays every run of the folder and prints a table for each game: script x error, with the median and the worst over
the seeds, the tolerance (`-`: for information) and the verdict. Takes about a minute.

Options:
      --traces DIR  the folder of the recordings: car_tracks.npz and what goes with it
  -h, --help        print this text

Exit codes:
  0  every tolerance is met
  1  a tolerance is missed
  2  the command line is wrong
  4  a recording cannot be read, or the folder has none
";

const HINT: &str = "\n  = hint: `dril-pipe env check --traces DIR` replays the recordings of a folder";

/// Answers `dril-pipe env ARGS`.
pub fn run(args: &[OsString]) -> Reply {
    if args.iter().any(|arg| arg == "--help" || arg == "-h") {
        return Reply::Done(HELP.to_owned());
    }
    match args {
        [command, rest @ ..] if command == "check" => match traces(rest) {
            Ok(folder) => compare(Path::new(&folder)),
            Err(message) => Reply::Usage(message + HINT),
        },
        [other, ..] => Reply::Usage(format!("`env` has no command `{}`{HINT}", other.display())),
        [] => Reply::Usage(format!("`env` needs a command{HINT}")),
    }
}

/// The folder of `--traces`.
fn traces(args: &[OsString]) -> Result<OsString, String> {
    let mut folder = None;
    let mut args = args.iter();
    while let Some(arg) = args.next() {
        let value = match arg.to_str().and_then(|text| text.strip_prefix("--traces")) {
            Some("") => args.next().cloned().ok_or("`--traces` needs a folder")?,
            Some(rest) if rest.starts_with('=') => OsString::from(&rest[1..]),
            _ => return Err(format!("unexpected argument `{}`, expected `--traces DIR`", arg.display())),
        };
        if folder.replace(value).is_some() {
            return Err("`--traces` was given twice".into());
        }
    }
    folder.ok_or_else(|| "`env check` needs the folder of the recordings".into())
}

fn compare(folder: &Path) -> Reply {
    match check::run(folder) {
        Ok(report) if report.passed() => Reply::Done(report.to_string()),
        Ok(report) => Reply::Failed(report.to_string()),
        Err(error @ CheckError::Empty { .. }) => Reply::Io(format!(
            "{error}\n  = hint: `--traces` takes the folder that holds the recordings themselves"
        )),
        Err(error) => Reply::Io(error.to_string()),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn answer(words: &[&str]) -> Reply {
        run(&words.iter().map(OsString::from).collect::<Vec<_>>())
    }

    #[test]
    fn help_is_no_mistake_and_names_the_exit_codes() {
        for words in [&["--help"][..], &["check", "-h"], &["check", "--traces", "x", "--help"]] {
            let Reply::Done(text) = answer(words) else { panic!("{words:?}") };
            assert!(text.contains("--traces DIR") && text.contains("  4  "), "{text}");
        }
    }

    #[test]
    fn wrong_arguments_are_named_with_what_was_expected() {
        for (words, said) in [
            (&[][..], "needs a command"),
            (&["chekc"], "no command `chekc`"),
            (&["check"], "needs the folder"),
            (&["check", "--traces"], "`--traces` needs a folder"),
            (&["check", "--traces=a", "--traces", "b"], "given twice"),
            (&["check", "--trace", "a"], "unexpected argument `--trace`"),
            (&["check", "--tracesx"], "unexpected argument `--tracesx`"),
        ] {
            let Reply::Usage(text) = answer(words) else { panic!("{words:?}") };
            assert!(text.contains(said) && text.contains("= hint: "), "{text}");
        }
    }

    #[test]
    fn a_folder_that_is_missing_or_empty_is_named() {
        let folder = tempfile::tempdir().unwrap();
        let missing = folder.path().join("nowhere");
        let Reply::Io(text) = answer(&["check", "--traces", &missing.to_string_lossy()]) else { panic!() };
        assert!(text.contains("cannot read") && text.contains("nowhere"), "{text}");
        let Reply::Io(text) = answer(&["check", &format!("--traces={}", folder.path().display())]) else {
            panic!()
        };
        assert!(text.contains("holds no recordings") && text.contains("car_tracks.npz"), "{text}");
    }
}
