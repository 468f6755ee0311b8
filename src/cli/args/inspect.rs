//! Arguments of the commands that look and change nothing: `explain`, `status`, `log`, `runs`, `diff`, `show`.

use clap::Args;

use super::{PipelineArgs, StoreArgs};

#[derive(Debug, Args)]
pub(in crate::cli) struct ExplainArgs {
    #[command(flatten)]
    pub pipeline: PipelineArgs,
    /// Stages: a name, an instance, or a pattern with `*` and `?`; without one, all that is not up to date
    #[arg(value_name = "STAGE")]
    pub stages: Vec<String>,
    #[command(flatten)]
    pub store: StoreArgs,
    /// Print as JSON
    #[arg(long)]
    pub json: bool,
}

#[derive(Debug, Args)]
pub(in crate::cli) struct StatusArgs {
    #[command(flatten)]
    pub pipeline: PipelineArgs,
    /// Stages: a name, an instance, or a pattern with `*` and `?`; without one, all
    #[arg(value_name = "STAGE")]
    pub stages: Vec<String>,
    #[command(flatten)]
    pub store: StoreArgs,
    /// One line for each stage instance
    #[arg(long, conflicts_with = "json")]
    pub all: bool,
    /// Print as JSON
    #[arg(long)]
    pub json: bool,
}

#[derive(Debug, Args)]
pub(in crate::cli) struct ShowArgs {
    #[command(flatten)]
    pub pipeline: PipelineArgs,
    /// Stages: a name, an instance, or a pattern with `*` and `?`
    #[arg(value_name = "STAGE", required = true)]
    pub stages: Vec<String>,
    #[command(flatten)]
    pub store: StoreArgs,
    /// Print as JSON
    #[arg(long)]
    pub json: bool,
}

#[derive(Debug, Args)]
pub(in crate::cli) struct LogArgs {
    /// Stages: a name, an instance, or a pattern with `*` and `?`
    #[arg(value_name = "STAGE", required = true)]
    pub stages: Vec<String>,
    /// The run, as `runs` lists it; without it, the latest that started the stage
    #[arg(short, long, value_name = "RUN")]
    pub run: Option<String>,
    #[command(flatten)]
    pub store: StoreArgs,
    /// Print only the last lines
    #[arg(short = 'n', long, value_name = "LINES")]
    pub tail: Option<usize>,
    /// Print the paths of the logs instead
    #[arg(long)]
    pub path: bool,
    /// Print as JSON
    #[arg(long, conflicts_with = "path")]
    pub json: bool,
}

#[derive(Debug, Args)]
pub(in crate::cli) struct RunsArgs {
    #[command(flatten)]
    pub store: StoreArgs,
    /// Only runs of this pipeline (the name in its file)
    #[arg(long, value_name = "NAME")]
    pub pipeline: Option<String>,
    /// At most so many, the latest first
    #[arg(short = 'n', long, value_name = "N", default_value_t = 20)]
    pub limit: usize,
    /// Print as JSON
    #[arg(long)]
    pub json: bool,
}

#[derive(Debug, Args)]
pub(in crate::cli) struct DiffArgs {
    /// The earlier run: its name, the start of its name, or `last~1` for the one before the last
    #[arg(value_name = "RUN1")]
    pub first: String,
    /// The later run
    #[arg(value_name = "RUN2", default_value = "last")]
    pub second: String,
    /// Only these stages: a name, an instance, or a pattern with `*` and `?`
    #[arg(long = "stage", value_name = "STAGE")]
    pub stages: Vec<String>,
    #[command(flatten)]
    pub store: StoreArgs,
    /// Print as JSON
    #[arg(long)]
    pub json: bool,
}
