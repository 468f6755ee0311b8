//! The command line: the only module that prints, reads the environment or exits.
//!
//! [`run`] is the whole program; a `main` hands in the stage kinds that it offers. Each subcommand is one file; `report`
//! has the ways to tell how a run goes.

mod args;
mod cache;
mod checked;
mod columns;
mod graph;
mod inspect;
mod kinds;
mod lockfile;
mod names;
mod page;
mod pipeline;
mod plan;
mod python;
mod replay;
mod report;
mod resources;
mod results;
mod run;
mod shell;
mod signals;
mod terminal;
mod unchanged;
pub mod untrusted;
mod watch;
mod why;

use std::ffi::{OsStr, OsString};
use std::path::Path;
use std::process::ExitCode;

use dril_stage_api::{Registry, Reply};

use crate::error::exit_codes;
use crate::exec;
use args::{Command, Request};
pub use page::{Page, keep_page};
pub use python::python_folders;
use terminal::{Terminal, print, print_error};

/// The argument that makes this program run one stage, for the engine that started it.
const STAGE: &str = "__stage";

/// A subcommand that a stage crate brings along.
#[derive(Clone, Copy, Debug)]
pub struct Extra {
    /// Its name on the command line.
    pub name: &'static str,
    /// One line for people.
    pub about: &'static str,
    /// Does the work with the arguments after the name.
    pub run: fn(&[OsString]) -> Reply,
}

/// Runs the program: `args` with the program's name first.
pub fn run(registry: Registry, args: impl IntoIterator<Item = OsString>) -> ExitCode {
    run_with(registry, &[], args)
}

/// As [`run`], with further subcommands.
pub fn run_with(registry: Registry, extras: &[Extra], args: impl IntoIterator<Item = OsString>) -> ExitCode {
    let args: Vec<OsString> = args.into_iter().collect();
    // Before anything else: this is what every stage pays.
    if let Some(job) = stage_job(&args) {
        return exec::run_stage(Path::new(job), &registry);
    }
    if let [_, name] = &*args
        && name == exec::WARDEN
    {
        return exec::watch_over();
    }
    match args::read(args, extras, Terminal::stdout().colour) {
        Request::Own(command) => own(&command, &registry, extras),
        Request::Extra(index, args) => extra(&extras[index], &args),
        Request::Answer(text, is_mistake, code) => {
            if is_mistake {
                print_error(&text);
            } else {
                let _ = print(&text);
            }
            ExitCode::from(code)
        }
    }
}

/// Runs a program that works for an engine: `args` is `PROGRAM __stage JOB`, or the program, the name of one of the
/// services and its arguments.
pub fn run_worker(
    registry: &Registry,
    services: &[Extra],
    args: impl IntoIterator<Item = OsString>,
) -> ExitCode {
    let args: Vec<OsString> = args.into_iter().collect();
    let service = services.iter().find(|service| args.get(1).is_some_and(|name| name == service.name));
    match (stage_job(&args), service) {
        (Some(job), _) => exec::run_stage(Path::new(job), registry),
        (None, Some(service)) => extra(service, &args[2..]),
        (None, None) => {
            print_error(
                "error: this program runs single stages for `dril-pipe`\n  = hint: run `dril-pipe --help`\n",
            );
            ExitCode::from(exit_codes::USAGE)
        }
    }
}

fn stage_job(args: &[OsString]) -> Option<&OsStr> {
    match args {
        [_, stage, job] if stage == STAGE => Some(job),
        _ => None,
    }
}

fn own(command: &Command, registry: &Registry, extras: &[Extra]) -> ExitCode {
    let done = match command {
        Command::Run(args) => run::main(args, registry),
        Command::Watch(args) => watch::main(args, registry),
        Command::Plan(args) => plan::main(args, registry),
        Command::Explain(args) => inspect::explain::main(args, registry),
        Command::Status(args) => inspect::status::main(args, registry),
        Command::Show(args) => inspect::show::main(args, registry),
        Command::Log(args) => inspect::log::main(args),
        Command::Runs(args) => inspect::runs::main(args),
        Command::Diff(args) => inspect::diff::main(args),
        Command::Report(args) => page::main(args, registry),
        Command::Cache(args) => cache::main(args, registry),
        Command::Graph(args) => graph::main(args, registry),
        Command::Kinds(args) => kinds::main(args, registry),
        Command::Schema => shell::schema(registry),
        Command::Completions(args) => shell::completions(args, extras),
        Command::Man(args) => shell::man(args, extras),
        Command::Replay(args) => replay::main(args, registry),
    };
    done.unwrap_or_else(|error| {
        if command.speaks_json() {
            let _ = print(&report::error_line(&error));
        }
        print_error(&error.to_string());
        ExitCode::from(error.kind().exit_code())
    })
}

fn extra(extra: &Extra, args: &[OsString]) -> ExitCode {
    let (text, code) = match (extra.run)(args) {
        Reply::Done(text) => return printed(&text, exit_codes::OK),
        Reply::Failed(text) => return printed(&text, exit_codes::STAGE_FAILED),
        Reply::Refused(text) => (text, exit_codes::STAGE_FAILED),
        Reply::Usage(text) => (text, exit_codes::USAGE),
        Reply::Io(text) => (text, exit_codes::IO),
    };
    print_error(&format!("error: {}\n", text.trim_end()));
    ExitCode::from(code)
}

/// Prints an answer; `code` is the exit code where that works.
fn printed(text: &str, code: u8) -> ExitCode {
    match print(text) {
        Ok(()) => ExitCode::from(code),
        Err(error) => ExitCode::from(error.kind().exit_code()),
    }
}
