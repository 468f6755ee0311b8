//! `dril-pipe env`: what the environments offer on the command line.

use std::ffi::OsString;
use std::path::Path;

use dril_stage_api::Reply;

use crate::{CheckError, Report};

/// One line about it, for the list of commands.
pub const ABOUT: &str = "Check the environments against recordings of the originals, and against Gymnasium";

const HELP: &str = "\
Check the environments against recordings of the originals, and against Gymnasium

Usage: dril-pipe env check [--traces DIR] [--gymnasium]

With `--traces`, replays every run of the folder; with `--gymnasium`, lands the same pilot on 500 seeds of our
LunarLander and 500 of Gymnasium's. Prints a table for each game: script x error, with the median and the worst over
the seeds, the tolerance (`-`: for information) and the verdict. Each takes about a minute.

Options:
      --traces DIR  the folder of the recordings: car_tracks.npz and what goes with it
      --gymnasium   play Gymnasium's own game; its Python packages are installed when first needed
  -h, --help        print this text

Exit codes:
  0  every tolerance is met
  1  a tolerance is missed
  2  the command line is wrong
  4  a recording cannot be read, the folder has none, or Gymnasium cannot be played
";

const HINT: &str = "\n  = hint: `dril-pipe env check --traces DIR` replays the recordings of a folder, `dril-pipe env check \
                    --gymnasium` plays beside Gymnasium";

/// What to compare with.
#[derive(Debug, Default, PartialEq)]
struct Originals {
    traces: Option<OsString>,
    gymnasium: bool,
}

/// Answers `dril-pipe env ARGS`.
pub fn run(args: &[OsString]) -> Reply {
    if args.iter().any(|arg| arg == "--help" || arg == "-h") {
        return Reply::Done(HELP.to_owned());
    }
    match args {
        [command, rest @ ..] if command == "check" => match originals(rest) {
            Ok(originals) => compare(&originals),
            Err(message) => Reply::Usage(message + HINT),
        },
        [other, ..] => Reply::Usage(format!("`env` has no command `{}`{HINT}", other.display())),
        [] => Reply::Usage(format!("`env` needs a command{HINT}")),
    }
}

fn originals(args: &[OsString]) -> Result<Originals, String> {
    let mut originals = Originals::default();
    let mut args = args.iter();
    while let Some(arg) = args.next() {
        if arg == "--gymnasium" {
            originals.gymnasium = true;
            continue;
        }
        let folder = match arg.to_str().and_then(|text| text.strip_prefix("--traces")) {
            Some("") => args.next().cloned().ok_or("`--traces` needs a folder")?,
            Some(rest) if rest.starts_with('=') => OsString::from(&rest[1..]),
            _ => {
                let (seen, expected) = (arg.display(), "`--traces DIR` or `--gymnasium`");
                return Err(format!("unexpected argument `{seen}`, expected {expected}"));
            }
        };
        if originals.traces.replace(folder).is_some() {
            return Err("`--traces` was given twice".into());
        }
    }
    if originals == Originals::default() {
        return Err("`env check` needs to know what to compare with".into());
    }
    Ok(originals)
}

fn compare(originals: &Originals) -> Reply {
    match report(originals) {
        Ok(report) if report.passed() => Reply::Done(report.to_string()),
        Ok(report) => Reply::Failed(report.to_string()),
        Err(error @ CheckError::Empty { .. }) => Reply::Io(format!(
            "{error}\n  = hint: `--traces` takes the folder that holds the recordings themselves"
        )),
        Err(error) => Reply::Io(error.to_string()),
    }
}

fn report(originals: &Originals) -> Result<Report, CheckError> {
    let mut report = match &originals.traces {
        Some(folder) => crate::run(Path::new(folder))?,
        None => Report::default(),
    };
    if originals.gymnasium {
        crate::landings(&mut report)?;
    }
    Ok(report)
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
            for part in ["--traces DIR", "--gymnasium", "  4  "] {
                assert!(text.contains(part), "{text}");
            }
        }
    }

    #[test]
    fn wrong_arguments_are_named_with_what_was_expected() {
        for (words, said) in [
            (&[][..], "needs a command"),
            (&["chekc"], "no command `chekc`"),
            (&["check"], "what to compare with"),
            (&["check", "--traces"], "`--traces` needs a folder"),
            (&["check", "--traces=a", "--traces", "b"], "given twice"),
            (&["check", "--trace", "a"], "unexpected argument `--trace`"),
            (&["check", "--tracesx"], "unexpected argument `--tracesx`"),
            (&["check", "--gymnasium", "x"], "unexpected argument `x`"),
        ] {
            let Reply::Usage(text) = answer(words) else { panic!("{words:?}") };
            assert!(text.contains(said) && text.contains("= hint: "), "{text}");
        }
    }

    #[test]
    fn recordings_and_gymnasium_may_be_asked_for_together() {
        let read = |words: &[&str]| originals(&words.iter().map(OsString::from).collect::<Vec<_>>());
        let traces = Some(OsString::from("a"));
        assert_eq!(read(&["--gymnasium"]), Ok(Originals { traces: None, gymnasium: true }));
        assert_eq!(
            read(&["--gymnasium", "--traces=a"]),
            Ok(Originals { traces: traces.clone(), gymnasium: true })
        );
        assert_eq!(read(&["--traces", "a"]), Ok(Originals { traces, gymnasium: false }));
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
