//! Arguments for where stages run.

use std::convert::Infallible;
use std::str::FromStr;

use clap::Args;

/// Where stages run.
#[derive(Debug, Args)]
pub(in crate::cli) struct ExecutorArgs {
    /// Where stages run: `local`, `slurm`, or the name of an executor; settings of jobs are in `dril-pipe.toml`
    #[arg(long, value_name = "WHERE", default_value = "local")]
    pub executor: Executor,
    /// When interrupted, leave the jobs of the cluster running; the next run finds them
    #[arg(long)]
    pub detach: bool,
}

/// An executor.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(in crate::cli) enum Executor {
    /// This machine.
    Local,
    /// A Slurm cluster.
    Slurm,
    /// An executor of the settings.
    Named(String),
}

impl FromStr for Executor {
    type Err = Infallible;

    fn from_str(text: &str) -> Result<Self, Infallible> {
        Ok(match text {
            "local" => Self::Local,
            "slurm" => Self::Slurm,
            name => Self::Named(name.to_owned()),
        })
    }
}
