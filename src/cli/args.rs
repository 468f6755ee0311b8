//! The command line as clap parses it, and nothing else: no other file names clap.

mod cache;
mod executor;
mod inspect;
mod page;
mod remote;
pub(super) mod shell;
mod tool;

use std::ffi::OsString;
use std::num::NonZeroUsize;
use std::path::PathBuf;

use clap::{ArgMatches, Args, CommandFactory, FromArgMatches, Parser, Subcommand, ValueEnum};

use super::Extensions;
use crate::resolve::{Choices, Selection};
use crate::spec::limits::parse_time;
pub(super) use cache::{
    CacheArgs, CacheCommand, DoctorArgs, DuArgs, ExportArgs, GcArgs, ImportArgs, VerifyArgs,
};
pub(super) use executor::{Executor, ExecutorArgs};
pub(super) use inspect::{DiffArgs, ExplainArgs, LogArgs, RunsArgs, ShowArgs, StatusArgs};
pub(super) use page::ReportArgs;
pub(super) use remote::{RemoteArgs, RemoteModeArgs, TransferArgs};
pub(super) use shell::{CompletionsArgs, ManArgs};
pub(super) use tool::ToolArgs;

const EXIT_CODES: &str = "\
Exit codes:
  0    success
  1    a stage failed; stages that do not depend on it were run
  2    invalid command line
  3    invalid pipeline file, or a file that it names is missing; nothing ran
  4    the cache, the results folder or another file cannot be read or written, or an executable is missing
  5    a check failed: the cache is damaged, or results differ from the lock file or from an earlier run
  6    the time limit of `run --for` was reached; the next run resumes
  130  stopped by SIGINT, SIGTERM or SIGHUP; the next run resumes";

/// Run experiment pipelines: a YAML file describes a DAG of typed stages; only stages whose inputs changed are run
#[derive(Debug, Parser)]
#[command(name = "dril-pipe", bin_name = "dril-pipe", version, after_help = EXIT_CODES, disable_help_subcommand = true)]
struct Cli {
    #[command(subcommand)]
    command: Command,
}

/// What to do.
#[derive(Debug, Subcommand)]
pub(super) enum Command {
    /// Run every stage that is not cached, and copy tables and figures to the results folder
    #[command(after_help = EXIT_CODES)]
    Run(RunArgs),
    /// Run, and run again whenever the pipeline file or one of its input files changes
    Watch(RunArgs),
    /// Show what would run and why, without running it
    Plan(PlanArgs),
    /// Explain why stages are stale: the changed parameter, input or revision, traced back to the first cause
    Explain(ExplainArgs),
    /// Show which stages are fresh, stale, running or failed, with their age and duration
    Status(StatusArgs),
    /// Show the key, parameters, outputs and provenance of a stage
    Show(ShowArgs),
    /// Print the logs of stages
    Log(LogArgs),
    /// List past and current runs
    Runs(RunsArgs),
    /// Compare two runs: parameters, inputs and results
    Diff(DiffArgs),
    /// Write an HTML report of the results as they are now, without running anything
    Report(ReportArgs),
    /// Manage the cache: verify, gc, disk usage, export and import
    Cache(CacheArgs),
    /// Print the DAG of stages as DOT, Mermaid or JSON
    Graph(GraphArgs),
    /// List the stage kinds, or the parameters, inputs and outputs of one kind
    Kinds(KindsArgs),
    /// Print the JSON Schema of pipeline files, for editors
    Schema,
    /// Print a shell completion script
    Completions(CompletionsArgs),
    /// Print the man page, or write the man pages of all commands
    Man(ManArgs),
}

impl Command {
    /// True for `run --json`, which also prints errors as JSON lines.
    pub fn prints_json(&self) -> bool {
        matches!(self, Self::Run(args) | Self::Watch(args) if args.json)
    }
}

/// The pipeline, and overrides.
#[derive(Debug, Args)]
pub(super) struct PipelineArgs {
    /// The pipeline file (YAML)
    #[arg(value_name = "FILE")]
    pub file: PathBuf,
    /// The profile [default: the first one in the file]
    #[arg(short, long, value_name = "NAME")]
    profile: Option<String>,
    /// Override a value, as in `--set dril.total_timesteps=98304`; can be repeated
    #[arg(short, long, value_name = "PATH=VALUE")]
    set: Vec<String>,
}

impl PipelineArgs {
    /// As input of the resolver.
    pub fn choices(&self) -> Choices {
        Choices { profile: self.profile.clone(), set: self.set.clone(), ..Choices::default() }
    }
}

/// The stages of the pipeline.
#[derive(Debug, Args)]
pub(super) struct SelectArgs {
    /// Target stages; they and everything upstream are brought up to date: `table22`, `'table*'`, `'evaluate[policy=beta]'`
    /// [default: all]
    #[arg(value_name = "STAGE")]
    targets: Vec<String>,
    /// Of the targets, only this stage and stages downstream of it; can be repeated
    #[arg(long, value_name = "STAGE")]
    from: Vec<String>,
    /// Run only the targets; fail if something that they need is not cached
    #[arg(long)]
    only: bool,
    /// Run this stage even if it is cached, and start it without its checkpoint; can be repeated
    #[arg(long, value_name = "STAGE")]
    force: Vec<String>,
}

impl SelectArgs {
    /// As input of the resolver.
    pub fn selection(&self) -> Selection {
        let Self { targets, from, only, force } = self;
        Selection { targets: targets.clone(), from: from.clone(), force: force.clone(), only: *only }
    }
}

/// The cache.
#[derive(Debug, Args)]
pub(super) struct StoreArgs {
    /// The cache folder [env: DRIL_PIPE_CACHE] [default: `cache` in the current folder]
    #[arg(long, value_name = "DIR")]
    cache: Option<PathBuf>,
}

impl StoreArgs {
    /// The cache folder; `env` is the value of DRIL_PIPE_CACHE.
    pub fn folder(&self, env: Option<OsString>) -> PathBuf {
        let env = env.filter(|value| !value.is_empty()).map(PathBuf::from);
        self.cache.clone().or(env).unwrap_or_else(|| PathBuf::from("cache"))
    }
}

#[derive(Debug, Args)]
pub(super) struct RunArgs {
    #[command(flatten)]
    pub pipeline: PipelineArgs,
    #[command(flatten)]
    pub select: SelectArgs,
    #[command(flatten)]
    pub store: StoreArgs,
    #[command(flatten)]
    pub executor: ExecutorArgs,
    #[command(flatten)]
    pub remote: RemoteArgs,
    #[command(flatten)]
    pub remote_mode: RemoteModeArgs,
    /// The folder for tables and figures [default: `results/<pipeline>-<profile>`]
    #[arg(short, long, value_name = "DIR")]
    pub out: Option<PathBuf>,
    /// Number of threads that running stages may use in total [default: all]
    #[arg(short, long, value_name = "N", value_parser = at_least_one)]
    pub jobs: Option<NonZeroUsize>,
    /// Available units of each resource, as in `gpu=2,licence=5` [default: 1 of each, and all GPUs of the machine]
    #[arg(long, value_name = "NAME=N", value_delimiter = ',', value_parser = resource)]
    pub resources: Vec<(String, u32)>,
    /// Seconds between checkpoints of a stage
    #[arg(long, value_name = "SECONDS", default_value = "120", value_parser = seconds)]
    pub checkpoint_every: f64,
    /// Write the learning curves of training stages to this folder, as TensorBoard event files
    #[arg(long, value_name = "DIR")]
    pub tensorboard: Option<PathBuf>,
    /// Start no further stages after a failure
    #[arg(long)]
    pub fail_fast: bool,
    /// Stop cleanly after this time, as in `2h` or `1h30m`, and report what is left
    #[arg(long = "for", value_name = "TIME", value_parser = time)]
    pub time: Option<std::time::Duration>,
    /// After the run, run every stage a second time and fail if an output differs
    #[arg(long)]
    pub check_determinism: bool,
    /// Write the key and output digests of every stage to the lock file (`thesis.lock` for `thesis.yaml`)
    #[arg(long, conflicts_with_all = ["locked", "set", "targets", "from"])]
    pub lock: bool,
    /// Fail if a key or an output differs from the lock file, if possible before anything runs
    #[arg(long, conflicts_with_all = ["targets", "from"])]
    pub locked: bool,
    /// After a failure, run the stages that do not depend on the failed one (the default)
    #[arg(long, conflicts_with = "fail_fast")]
    pub keep_going: bool,
    /// Only show what would run, like `plan`
    #[arg(short = 'n', long, conflicts_with = "quiet")]
    pub dry_run: bool,
    /// Print events as JSON, one object per line
    #[arg(long, conflicts_with = "quiet")]
    pub json: bool,
    /// Print only errors
    #[arg(short, long)]
    pub quiet: bool,
}

#[derive(Debug, Args)]
pub(super) struct PlanArgs {
    #[command(flatten)]
    pub pipeline: PipelineArgs,
    #[command(flatten)]
    pub select: SelectArgs,
    #[command(flatten)]
    pub store: StoreArgs,
    /// Show one line per stage instance, including cached ones
    #[arg(long, conflicts_with = "json")]
    pub all: bool,
    /// Forecast the run on `slurm` or another executor: jobs, time and critical path, from the times of earlier runs
    #[arg(long, value_name = "WHERE", default_value = "local")]
    pub executor: Executor,
    /// Print the plan as JSON
    #[arg(long)]
    pub json: bool,
}

#[derive(Debug, Args)]
pub(super) struct GraphArgs {
    #[command(flatten)]
    pub pipeline: PipelineArgs,
    /// Output format: Graphviz (pipe it to `dot -Tsvg`), Mermaid (for Markdown), or JSON
    #[arg(short, long, value_enum, default_value_t = GraphFormat::Dot)]
    pub format: GraphFormat,
    /// One node per stage of the file (the default)
    #[arg(long, conflicts_with = "instances")]
    stages: bool,
    /// One node per stage instance
    #[arg(long)]
    pub instances: bool,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub(super) enum GraphFormat {
    Dot,
    Mermaid,
    Json,
}

#[derive(Debug, Args)]
pub(super) struct KindsArgs {
    /// The kind to describe [default: list all]
    pub kind: Option<String>,
    /// Print JSON, including the JSON Schema of the parameters
    #[arg(long)]
    pub json: bool,
}

/// The parsed command line.
#[derive(Debug)]
pub(super) enum Request {
    /// One of the engine's own commands.
    Own(Box<Command>),
    /// One of the extra subcommands, with the arguments after its name.
    Extra(usize, Vec<OsString>),
    /// One of the tools.
    Tool(usize, ToolArgs),
    /// Help, version, or an error: the text, whether it goes to stderr, and the exit code.
    Answer(String, bool, u8),
}

/// Parses `args`, which start with the program's name.
pub(super) fn read(args: Vec<OsString>, extensions: &Extensions<'_>, colour: bool) -> Request {
    let matches = match command(extensions, colour).try_get_matches_from(args) {
        Ok(matches) => matches,
        Err(error) => return answer(&error, colour),
    };
    if let Some((name, below)) = matches.subcommand() {
        let Extensions { commands, tools } = extensions;
        if let Some(index) = commands.iter().position(|command| command.name == name) {
            return Request::Extra(index, rest(below));
        }
        if let Some(index) = tools.iter().position(|tool| tool.name == name) {
            return match tool::read(&tools[index], below) {
                Ok(args) => Request::Tool(index, args),
                Err(error) => answer(&error, colour),
            };
        }
    }
    match Cli::from_arg_matches(&matches) {
        Ok(cli) => Request::Own(Box::new(cli.command)),
        Err(error) => answer(&error, colour),
    }
}

fn command(extensions: &Extensions<'_>, colour: bool) -> clap::Command {
    let choice = if colour { clap::ColorChoice::Always } else { clap::ColorChoice::Never };
    let command = Cli::command().color(choice);
    let command = command.subcommands(extensions.tools.iter().map(tool::command));
    extensions.commands.iter().fold(command, |command, extra| {
        let rest = clap::Arg::new("args").num_args(0..).trailing_var_arg(true).allow_hyphen_values(true);
        let rest = rest.value_parser(clap::value_parser!(OsString));
        command
            .subcommand(clap::Command::new(extra.name).about(extra.about).disable_help_flag(true).arg(rest))
    })
}

fn rest(matches: &ArgMatches) -> Vec<OsString> {
    matches.get_many::<OsString>("args").map(|args| args.cloned().collect()).unwrap_or_default()
}

fn answer(error: &clap::Error, colour: bool) -> Request {
    let text = error.render();
    let text = if colour { text.ansi().to_string() } else { text.to_string() };
    let code = u8::try_from(error.exit_code()).unwrap_or(crate::error::exit_codes::USAGE);
    Request::Answer(text, error.use_stderr(), code)
}

/// `gpu=2`
fn resource(text: &str) -> Result<(String, u32), String> {
    let Some((name, count)) = text.split_once('=') else {
        return Err("expected a name and a whole number, as in `gpu=2`".to_owned());
    };
    let count = count.parse().map_err(|_| format!("`{count}` is not a whole number of at least 0"))?;
    Ok((name.to_owned(), count))
}

fn time(text: &str) -> Result<std::time::Duration, String> {
    parse_time(text)
}

fn at_least_one(text: &str) -> Result<NonZeroUsize, String> {
    text.parse().map_err(|_| "expected a whole number of at least 1".to_owned())
}

fn seconds(text: &str) -> Result<f64, String> {
    match text.parse::<f64>() {
        Ok(seconds) if seconds.is_finite() && seconds >= 0.0 => Ok(seconds),
        _ => Err("expected a number of seconds of at least 0".to_owned()),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::cli::ExtraCommand;
    use dril_stage_api::Reply;

    fn read_words(words: &str) -> Request {
        let run = |_: &[OsString]| Reply::Done(String::new());
        let env = ExtraCommand { name: "env", about: "environments", run };
        let extensions = Extensions { commands: &[env], tools: &[] };
        read(words.split(' ').map(OsString::from).collect(), &extensions, false)
    }

    #[test]
    fn the_definition_is_sound() {
        Cli::command().debug_assert();
    }

    #[test]
    fn help_lists_every_exit_code() {
        use crate::error::exit_codes::*;
        for code in [OK, STAGE_FAILED, USAGE, PIPELINE, IO, CHECK_FAILED, OUT_OF_TIME, INTERRUPTED] {
            assert!(EXIT_CODES.contains(&format!("\n  {code:<4} ")), "{code}");
        }
    }

    #[test]
    fn an_extra_subcommand_gets_its_arguments_as_they_are() {
        let Request::Extra(0, args) = read_words("dril-pipe env check --traces x --help") else { panic!() };
        assert_eq!(args, ["check", "--traces", "x", "--help"]);
    }

    #[test]
    fn a_wrong_command_line_ends_in_the_code_for_usage() {
        for words in ["dril-pipe", "dril-pipe rum a.yaml", "dril-pipe run"] {
            let Request::Answer(text, true, 2) = read_words(words) else { panic!("{words}") };
            assert!(text.contains("Usage"), "{text}");
        }
    }
}
