//! Arguments of the commands that look and change nothing: `explain`, `status`, `log`, `runs`, `diff`, `show`.

use clap::Args;

use super::{PipelineArgs, StoreArgs};

/// Stages of a pipeline and a store to look at.
#[derive(Debug, Args)]
pub(in crate::cli) struct LookArgs {
    #[command(flatten)]
    pub pipeline: PipelineArgs,
    /// Stages: `table22`, `'table*'`, `'evaluate[policy=beta]'`
    #[arg(value_name = "STAGE")]
    pub stages: Vec<String>,
    #[command(flatten)]
    pub store: StoreArgs,
    /// Print as JSON
    #[arg(long)]
    pub json: bool,
}

#[derive(Debug, Args)]
#[command(after_help = "Without a STAGE, all that is not up to date is explained.")]
pub(in crate::cli) struct ExplainArgs {
    #[command(flatten)]
    pub look: LookArgs,
}

#[derive(Debug, Args)]
#[command(after_help = "Without a STAGE, all are shown.")]
pub(in crate::cli) struct StatusArgs {
    #[command(flatten)]
    pub look: LookArgs,
    /// One line for each stage instance
    #[arg(long, conflicts_with = "json")]
    pub all: bool,
}

#[derive(Debug, Args)]
#[command(mut_arg("stages", |stages| stages.required(true)))]
pub(in crate::cli) struct ShowArgs {
    #[command(flatten)]
    pub look: LookArgs,
}

#[derive(Debug, Args)]
pub(in crate::cli) struct LogArgs {
    /// Stages: `table22`, `'table*'`, `'evaluate[policy=beta]'`
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
    /// Only these stages: `table22`, `'table*'`, `'evaluate[policy=beta]'`; may be given several times
    #[arg(long = "stage", value_name = "STAGE")]
    pub stages: Vec<String>,
    #[command(flatten)]
    pub store: StoreArgs,
    /// Print as JSON
    #[arg(long)]
    pub json: bool,
}
