//! The command line: the only module that prints, reads the environment or exits.
//!
//! [`run`] is the whole program; `main` passes the stage kinds. `commands` has one file per subcommand, and `report` the
//! ways to show the progress of a run.

mod args;
mod change;
mod columns;
mod commands;
mod executor;
mod giving;
mod names;
mod pipeline;
mod report;
mod resources;
mod shared;
mod signals;
mod terminal;
pub mod untrusted;
mod warnings;
mod why;

use std::ffi::{OsStr, OsString};
use std::path::Path;
use std::process::ExitCode;
use std::time::Instant;

use dril_stage_api::{Registry, Reply, Tool};

use crate::cluster;
use crate::error::{Error, exit_codes};
use crate::exec;
use args::{Command, Request};
pub use commands::page::{Page, keep_page};
use commands::{cache, graph, inspect, kinds, page, plan, run, shell, tool, watch};
use terminal::{Terminal, print, print_error};

/// The argument that makes this program run one stage, for the engine that started it.
const STAGE: &str = "__stage";

/// A subcommand that a stage package brings along and that parses its own arguments.
#[derive(Clone, Copy, Debug)]
pub struct ExtraCommand {
    /// Its name on the command line.
    pub name: &'static str,
    /// One line for `--help`.
    pub about: &'static str,
    /// Does the work with the arguments after the name.
    pub run: fn(&[OsString]) -> Reply,
}

/// What stage packages add to the command line.
#[derive(Clone, Copy, Debug, Default)]
pub struct Extensions<'a> {
    /// Subcommands that parse their own arguments.
    pub commands: &'a [ExtraCommand],
    /// Subcommands that work on one artifact.
    pub tools: &'a [Tool],
}

/// Runs the program: `args` starts with the program's name.
pub fn run(registry: Registry, args: impl IntoIterator<Item = OsString>) -> ExitCode {
    run_with(registry, Extensions::default(), args)
}

/// As [`run`], with further subcommands.
pub fn run_with(
    registry: Registry,
    extensions: Extensions<'_>,
    args: impl IntoIterator<Item = OsString>,
) -> ExitCode {
    let args: Vec<OsString> = args.into_iter().collect();
    // First of all: every stage pays for what happens before this.
    if let Some(job) = stage_job(&args) {
        return exec::run_stage(Path::new(job), &registry);
    }
    if let [_, name, folder] = &*args
        && (name == cluster::NODE || name == cluster::PILOT)
    {
        let run = if name == cluster::NODE { cluster::run_on_node } else { cluster::run_pilot };
        let job = std::env::var(cluster::JOB).or_else(|_| std::env::var("SLURM_JOB_ID")).unwrap_or_default();
        let assigned = cluster::Assigned { job, gpus: std::env::var(resources::GPUS).ok() };
        return run(Path::new(folder), &assigned, &registry).unwrap_or_else(|error| {
            print_error(&format!("error: {error}\n"));
            ExitCode::FAILURE
        });
    }
    if let [_, name] = &*args
        && name == exec::WARDEN
    {
        return exec::watch_over();
    }
    match args::read(args, &extensions, Terminal::stdout().colour) {
        Request::Own(command) => own(&command, &registry, &extensions),
        Request::Extra(index, args) => extra(&extensions.commands[index], &args),
        Request::Tool(index, args) => {
            tool::main(&extensions.tools[index], &args, &registry).unwrap_or_else(|error| failed(&error))
        }
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

/// Runs a worker executable: `args` is `PROGRAM __stage JOB`, or `PROGRAM SERVICE` with the arguments of the service.
pub fn run_worker(
    registry: &Registry,
    services: &[ExtraCommand],
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

fn own(command: &Command, registry: &Registry, extensions: &Extensions<'_>) -> ExitCode {
    let began = Instant::now();
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
        Command::Completions(args) => shell::completions(args, extensions),
        Command::Man(args) => shell::man(args, extensions),
    };
    done.unwrap_or_else(|error| {
        if command.prints_json() {
            let _ = print(&report::error_line(&error, began));
        }
        failed(&error)
    })
}

fn failed(error: &Error) -> ExitCode {
    print_error(&error.to_string());
    ExitCode::from(error.kind().exit_code())
}

fn extra(extra: &ExtraCommand, args: &[OsString]) -> ExitCode {
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
