//! The command line as clap reads it, and nothing else: no other file names clap.

mod cache;
mod inspect;
mod page;
pub(super) mod shell;

use std::ffi::OsString;
use std::num::NonZeroUsize;
use std::path::PathBuf;

use clap::{ArgMatches, Args, CommandFactory, FromArgMatches, Parser, Subcommand, ValueEnum};

use super::Extra;
use crate::resolve::{Choices, Selection};
use crate::spec::limits::parse_time;
pub(super) use cache::{CacheArgs, CacheCommand, DuArgs, ExportArgs, GcArgs, ImportArgs, VerifyArgs};
pub(super) use inspect::{DiffArgs, ExplainArgs, LogArgs, RunsArgs, ShowArgs, StatusArgs};
pub(super) use page::ReportArgs;
pub(super) use shell::{CompletionsArgs, ManArgs};

const EXIT_CODES: &str = "\
Exit codes:
  0    done
  1    a stage failed; what does not depend on it was done
  2    the command line is wrong
  3    the pipeline file is wrong, or a file that it names is missing; nothing ran
  4    the store, the results folder or another file could not be read or written, or a program is missing
  5    a check did not hold: the store is damaged, or results are not what they were
  6    the time of `run --for` was over; the next run goes on from there
  130  stopped by SIGINT, SIGTERM or SIGHUP; the next run goes on from there";

const REPLAY_EXAMPLES: &str = "\
Examples:
  dril-pipe replay pipelines/thesis.yaml:dril.peak[policy=beta] --profile desk --seed 7 --out lap.gif
  dril-pipe replay policy.safetensors --env '{ gymnasium: CarRacing-v3 }' --out lap.apng";

/// Runs pipelines of experiments: a YAML file of typed stages, hashed, cached, and run where something changed
#[derive(Debug, Parser)]
#[command(name = "dril-pipe", bin_name = "dril-pipe", version, after_help = EXIT_CODES, disable_help_subcommand = true)]
struct Cli {
    #[command(subcommand)]
    command: Command,
}

/// What to do.
#[derive(Debug, Subcommand)]
pub(super) enum Command {
    /// Run the stages that are not cached, and copy tables and figures to the results folder
    #[command(after_help = EXIT_CODES)]
    Run(RunArgs),
    /// Run, and run again whenever the pipeline file or a file that it reads changes
    Watch(RunArgs),
    /// Show what would run, and which parameter or input made it so; runs nothing
    Plan(PlanArgs),
    /// Say which field, input or revision made stages run, with old and new value, back to the first cause
    Explain(ExplainArgs),
    /// Show which stages are fresh, stale, running or failed, how old and how long they are
    Status(StatusArgs),
    /// Show a stage's parameters, digests and where everything in it comes from
    Show(ShowArgs),
    /// Print what a stage printed
    Log(LogArgs),
    /// List the runs on a store
    Runs(RunsArgs),
    /// Compare two runs: parameters, inputs and results
    Diff(DiffArgs),
    /// Write the results as one HTML page, for any state of the pipeline; runs nothing
    Report(ReportArgs),
    /// Look after the store: check it, make room, see what takes room, carry results to another machine
    Cache(CacheArgs),
    /// Print the graph of stages as DOT, Mermaid or JSON
    Graph(GraphArgs),
    /// List the stage kinds, or one kind's parameters, inputs and outputs
    Kinds(KindsArgs),
    /// Print the JSON Schema of pipeline files, for editors
    Schema,
    /// Print a script that completes command lines in a shell
    Completions(CompletionsArgs),
    /// Print the manual page, or write those of all commands
    Man(ManArgs),
    /// Write a film of an episode that a policy plays
    #[command(after_help = REPLAY_EXAMPLES)]
    Replay(ReplayArgs),
}

impl Command {
    /// True for `run --json`, whose errors are lines of JSON too.
    pub fn speaks_json(&self) -> bool {
        matches!(self, Self::Run(args) | Self::Watch(args) if args.json)
    }
}

/// Which pipeline, and what to change in it.
#[derive(Debug, Args)]
pub(super) struct PipelineArgs {
    /// The pipeline file (YAML)
    #[arg(value_name = "FILE")]
    pub file: PathBuf,
    /// The profile to run; without it, the first one of the file
    #[arg(short, long, value_name = "NAME")]
    profile: Option<String>,
    /// Change a value, as in `--set dril.total_timesteps=98304`; may be given several times
    #[arg(short, long, value_name = "PATH=VALUE")]
    set: Vec<String>,
}

impl PipelineArgs {
    /// As the resolver takes them.
    pub fn choices(&self) -> Choices {
        Choices { profile: self.profile.clone(), set: self.set.clone(), ..Choices::default() }
    }
}

/// Which of its stages.
#[derive(Debug, Args)]
pub(super) struct SelectArgs {
    /// Stages to bring up to date, with all that they need: `table22`, `'table*'`, `'evaluate[policy=beta]'`; without any, all
    #[arg(value_name = "STAGE")]
    targets: Vec<String>,
    /// Only this stage and those that depend on it (of the stages that were asked for); may be given several times
    #[arg(long, value_name = "STAGE")]
    from: Vec<String>,
    /// Nothing but the stages that were asked for: what they need must be cached
    #[arg(long)]
    only: bool,
    /// Run this stage although it is cached; may be given several times
    #[arg(long, value_name = "STAGE")]
    force: Vec<String>,
}

impl SelectArgs {
    /// As the resolver takes them.
    pub fn selection(&self) -> Selection {
        let Self { targets, from, only, force } = self;
        Selection { targets: targets.clone(), from: from.clone(), force: force.clone(), only: *only }
    }
}

/// Where finished work is kept.
#[derive(Debug, Args)]
pub(super) struct StoreArgs {
    /// The store of finished work [env: DRIL_PIPE_CACHE] [default: `cache` in the current folder]
    #[arg(long, value_name = "DIR")]
    cache: Option<PathBuf>,
}

impl StoreArgs {
    /// The store's folder; `env` is the value of DRIL_PIPE_CACHE.
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
    /// Where tables and figures go [default: `results/<pipeline>-<profile>`]
    #[arg(short, long, value_name = "DIR")]
    pub out: Option<PathBuf>,
    /// Threads that stages may keep busy side by side [default: those of the machine]
    #[arg(short, long, value_name = "N", value_parser = at_least_one)]
    pub jobs: Option<NonZeroUsize>,
    /// How many there are of a resource that stages ask for, as in `gpu=2,licence=5` [default: 1 of each; of `gpu`, those of
    /// the machine]
    #[arg(long, value_name = "NAME=N", value_delimiter = ',', value_parser = resource)]
    pub resources: Vec<(String, u32)>,
    /// Seconds between two checkpoints of a long stage
    #[arg(long, value_name = "SECONDS", default_value = "120", value_parser = seconds)]
    pub checkpoint_every: f64,
    /// Let stages that learn write their curves there, as TensorBoard event files
    #[arg(long, value_name = "DIR")]
    pub tensorboard: Option<PathBuf>,
    /// Start no further stage once one has failed
    #[arg(long)]
    pub fail_fast: bool,
    /// Stop cleanly after this time, as in `2h` or `1h30m`, and say what is left
    #[arg(long = "for", value_name = "TIME", value_parser = time)]
    pub time: Option<std::time::Duration>,
    /// Then run every stage once more, and fail where an output differs
    #[arg(long)]
    pub check_determinism: bool,
    /// Write what every stage was made as to the lock file beside the pipeline, `thesis.lock` for `thesis.yaml`
    #[arg(long, conflicts_with_all = ["locked", "set", "targets", "from"])]
    pub lock: bool,
    /// Fail where anything is not as the lock file says: before anything runs where that is known
    #[arg(long, conflicts_with_all = ["targets", "from"])]
    pub locked: bool,
    /// Go on with what does not depend on a failed stage (this is the default)
    #[arg(long, conflicts_with = "fail_fast")]
    pub keep_going: bool,
    /// Show what would run, as `plan` does, and run nothing
    #[arg(short = 'n', long, conflicts_with = "quiet")]
    pub dry_run: bool,
    /// Print what happens as lines of JSON
    #[arg(long, conflicts_with = "quiet")]
    pub json: bool,
    /// Print nothing but errors
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
    /// One line for each stage instance, cached ones too
    #[arg(long, conflicts_with = "json")]
    pub all: bool,
    /// Print the plan as JSON
    #[arg(long)]
    pub json: bool,
}

#[derive(Debug, Args)]
pub(super) struct GraphArgs {
    #[command(flatten)]
    pub pipeline: PipelineArgs,
    /// The language: Graphviz (pipe it into `dot -Tsvg`), Mermaid (Markdown pages show it), or JSON
    #[arg(short, long, value_enum, default_value_t = GraphFormat::Dot)]
    pub format: GraphFormat,
    /// One node for each stage of the file (the default)
    #[arg(long, conflicts_with = "instances")]
    stages: bool,
    /// One node for each stage instance
    #[arg(long)]
    pub instances: bool,
}

#[derive(Debug, Args)]
pub(super) struct ReplayArgs {
    /// A policy's file, or a finished stage of a pipeline, as in `pipelines/thesis.yaml:dril.peak[policy=beta]`
    pub policy: String,
    /// The seed of the track or level, and of a policy that acts at random
    #[arg(long, value_name = "N", default_value_t = 2_000_000)]
    pub seed: u64,
    /// The file to write: a film (`.gif`, `.apng`), or six moments side by side (`.png`)
    #[arg(short, long, value_name = "FILE")]
    pub out: PathBuf,
    /// The environment, as in a pipeline file [default: that of the stage, or the one that fits the policy]
    #[arg(long, value_name = "YAML")]
    pub env: Option<String>,
    /// How the policy acts
    #[arg(long, value_enum, default_value_t = ActingMode::Stochastic)]
    pub mode: ActingMode,
    /// Width of a picture in pixels
    #[arg(long, value_name = "PIXELS", default_value_t = 480)]
    pub width: u32,
    /// Draw every Nth step
    #[arg(long, value_name = "N", default_value_t = 2)]
    pub every: u32,
    /// How much faster than life the film runs
    #[arg(long, value_name = "FACTOR", default_value_t = 1.0)]
    pub speed: f64,
    /// The pipeline's profile; without it, the first one of the file
    #[arg(short, long, value_name = "NAME")]
    profile: Option<String>,
    /// Change a value of the pipeline; may be given several times
    #[arg(short, long, value_name = "PATH=VALUE")]
    set: Vec<String>,
    #[command(flatten)]
    pub store: StoreArgs,
}

impl ReplayArgs {
    /// The pipeline in `file` with what was chosen.
    pub fn pipeline(&self, file: &str) -> PipelineArgs {
        PipelineArgs { file: file.into(), profile: self.profile.clone(), set: self.set.clone() }
    }
}

#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub(super) enum ActingMode {
    Deterministic,
    Stochastic,
}

impl ActingMode {
    /// As a pipeline file has it.
    pub fn name(self) -> &'static str {
        match self {
            Self::Deterministic => "deterministic",
            Self::Stochastic => "stochastic",
        }
    }
}

#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub(super) enum GraphFormat {
    Dot,
    Mermaid,
    Json,
}

#[derive(Debug, Args)]
pub(super) struct KindsArgs {
    /// The kind to describe; without it, all are listed
    pub kind: Option<String>,
    /// Print as JSON, with the JSON Schema of the parameters
    #[arg(long)]
    pub json: bool,
}

/// What the arguments ask for.
#[derive(Debug)]
pub(super) enum Request {
    /// One of the program's own commands.
    Own(Box<Command>),
    /// A subcommand that was handed in, with the arguments after its name.
    Extra(usize, Vec<OsString>),
    /// Help, version, or a mistake: a text, for standard output or (a mistake) standard error, and an exit code.
    Answer(String, bool, u8),
}

/// Reads `args`, the program's name first.
pub(super) fn read(args: Vec<OsString>, extras: &[Extra], colour: bool) -> Request {
    let matches = match command(extras, colour).try_get_matches_from(args) {
        Ok(matches) => matches,
        Err(error) => return answer(&error, colour),
    };
    if let Some((name, below)) = matches.subcommand()
        && let Some(index) = extras.iter().position(|extra| extra.name == name)
    {
        return Request::Extra(index, rest(below));
    }
    match Cli::from_arg_matches(&matches) {
        Ok(cli) => Request::Own(Box::new(cli.command)),
        Err(error) => answer(&error, colour),
    }
}

fn command(extras: &[Extra], colour: bool) -> clap::Command {
    let choice = if colour { clap::ColorChoice::Always } else { clap::ColorChoice::Never };
    let command = Cli::command().color(choice);
    extras.iter().fold(command, |command, extra| {
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
    let count = count.parse().map_err(|_| format!("`{count}` is no whole number, 0 or more"))?;
    Ok((name.to_owned(), count))
}

fn time(text: &str) -> Result<std::time::Duration, String> {
    parse_time(text)
}

fn at_least_one(text: &str) -> Result<NonZeroUsize, String> {
    text.parse().map_err(|_| "expected a whole number, 1 or more".to_owned())
}

fn seconds(text: &str) -> Result<f64, String> {
    match text.parse::<f64>() {
        Ok(seconds) if seconds.is_finite() && seconds >= 0.0 => Ok(seconds),
        _ => Err("expected a number of seconds, 0 or more".to_owned()),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use dril_stage_api::Reply;

    fn read_words(words: &str) -> Request {
        let extra = Extra { name: "env", about: "environments", run: |_| Reply::Done(String::new()) };
        read(words.split(' ').map(OsString::from).collect(), &[extra], false)
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
    fn a_subcommand_that_was_handed_in_gets_its_arguments_as_they_are() {
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
