//! Arguments for where stages run.

use clap::{Args, ValueEnum};

/// Where stages run.
#[derive(Debug, Args)]
pub(in crate::cli) struct ExecutorArgs {
    /// Where stages run: on this machine, or as Slurm jobs with the settings of `dril-pipe.toml`
    #[arg(long, value_enum, default_value_t = Executor::Local)]
    pub executor: Executor,
    /// When interrupted, leave the Slurm jobs running; the next run finds them
    #[arg(long)]
    pub detach: bool,
}

/// An executor.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub(in crate::cli) enum Executor {
    /// This machine
    Local,
    /// A Slurm cluster
    Slurm,
}
