//! Arguments of the read-only commands `explain`, `status`, `log`, `runs`, `diff` and `show`.

use clap::Args;

use super::{PipelineArgs, StoreArgs};

/// Stages of a pipeline, and the cache.
#[derive(Debug, Args)]
pub(in crate::cli) struct InspectArgs {
    #[command(flatten)]
    pub pipeline: PipelineArgs,
    /// Stages: `table22`, `'table*'`, `'evaluate[policy=beta]'`
    #[arg(value_name = "STAGE")]
    pub stages: Vec<String>,
    #[command(flatten)]
    pub store: StoreArgs,
    /// Print JSON
    #[arg(long)]
    pub json: bool,
}

#[derive(Debug, Args)]
#[command(after_help = "Without STAGE, every stage that is not up to date is explained.")]
pub(in crate::cli) struct ExplainArgs {
    #[command(flatten)]
    pub look: InspectArgs,
}

#[derive(Debug, Args)]
#[command(after_help = "Without STAGE, all stages are shown.")]
pub(in crate::cli) struct StatusArgs {
    #[command(flatten)]
    pub look: InspectArgs,
    /// Show one line per stage instance
    #[arg(long, conflicts_with = "json")]
    pub all: bool,
}

#[derive(Debug, Args)]
#[command(mut_arg("stages", |stages| stages.required(true)))]
pub(in crate::cli) struct ShowArgs {
    #[command(flatten)]
    pub look: InspectArgs,
}

#[derive(Debug, Args)]
pub(in crate::cli) struct LogArgs {
    /// Stages: `table22`, `'table*'`, `'evaluate[policy=beta]'`
    #[arg(value_name = "STAGE", required = true)]
    pub stages: Vec<String>,
    /// The run, as listed by `runs` [default: of each instance the latest that started it]
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
    /// Print JSON
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
    /// Maximum number of runs, latest first
    #[arg(short = 'n', long, value_name = "N", default_value_t = 20)]
    pub limit: usize,
    /// Print JSON
    #[arg(long)]
    pub json: bool,
}

#[derive(Debug, Args)]
pub(in crate::cli) struct DiffArgs {
    /// The earlier run: its name, a prefix of its name, or `last~1` for the one before the last
    #[arg(value_name = "RUN1")]
    pub first: String,
    /// The later run
    #[arg(value_name = "RUN2", default_value = "last")]
    pub second: String,
    /// Only these stages: `table22`, `'table*'`, `'evaluate[policy=beta]'`; can be repeated
    #[arg(long = "stage", value_name = "STAGE")]
    pub stages: Vec<String>,
    #[command(flatten)]
    pub store: StoreArgs,
    /// Print JSON
    #[arg(long)]
    pub json: bool,
}
