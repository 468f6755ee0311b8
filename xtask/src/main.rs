//! `cargo xtask`: set-up and developer commands. This file only picks the command; each has a module of its own.
//!
//! The package depends on nothing but the standard library, so that the first command of a fresh clone starts within
//! seconds of being typed.
#![allow(clippy::print_stdout, clippy::print_stderr, reason = "a command line talks through its streams")]

mod demo;
mod error;
mod host;
mod install;
mod libtorch;
mod pages;
mod process;
mod test;
mod wheels;

use std::process::ExitCode;

use error::Error;

const HELP: &str = "\
Set-up and developer commands of dril-pipe.

Usage: cargo xtask <command>

Commands:
  libtorch      put a CPU libtorch 2.13.0 into `.libtorch` (downloads about 540 MB, once)
  demo [args]   libtorch, release build, then `dril-pipe run pipelines/thesis.yaml --profile smoke [args]`
  test          formatting, lints and all tests, quick ones first
  help          this text

Environment:
  LIBTORCH               a folder with another libtorch 2.13.0 (lib/ and include/), used as it is
  LIBTORCH_USE_PYTORCH   set to 1: use the torch 2.13.0 of the Python environment, for example with CUDA
  CARGO_TARGET_DIR       where the builds go";

fn main() -> ExitCode {
    let args: Vec<String> = std::env::args().skip(1).collect();
    match dispatch(&args) {
        Ok(()) => ExitCode::SUCCESS,
        Err(error) => {
            eprintln!("error: {error}");
            for hint in error.hints() {
                eprintln!("hint: {hint}");
            }
            ExitCode::from(error.exit_code())
        }
    }
}

fn dispatch(args: &[String]) -> Result<(), Error> {
    let root = process::root();
    let (command, rest) = args.split_first().map_or(("help", args), |(first, rest)| (first.as_str(), rest));
    match command {
        "libtorch" => no_more(rest).and_then(|()| libtorch::ensure(&root)),
        "demo" => demo::run(&root, rest),
        "test" => no_more(rest).and_then(|()| test::run(&root)),
        "help" | "--help" | "-h" => {
            println!("{HELP}");
            Ok(())
        }
        other => Err(Error::Usage { unknown: other.to_owned() }),
    }
}

fn no_more(rest: &[String]) -> Result<(), Error> {
    rest.first().map_or(Ok(()), |extra| Err(Error::Usage { unknown: extra.clone() }))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_unknown_command_is_a_usage_error() {
        let error = dispatch(&["instal".to_owned()]).unwrap_err();
        assert_eq!(error.exit_code(), 2);
        assert!(error.to_string().contains("`instal`"));
    }

    #[test]
    fn no_command_and_help_print_the_help() {
        assert!(dispatch(&[]).is_ok());
        assert!(dispatch(&["--help".to_owned()]).is_ok());
    }

    #[test]
    fn a_superfluous_argument_is_refused_before_any_work() {
        let args = ["libtorch".to_owned(), "--force".to_owned()];
        assert_eq!(dispatch(&args).unwrap_err().exit_code(), 2);
    }
}
