//! Arguments for a shared cache: which one, and what to move.

use std::path::PathBuf;

use clap::{Args, ValueEnum};

use super::{PipelineArgs, StoreArgs};
use crate::settings::Mode;

/// Which shared cache.
#[derive(Debug, Args)]
pub(in crate::cli) struct RemoteArgs {
    /// The shared cache: `s3://bucket/prefix`, `file:///folder`, `https://host/path` (read only), or `off` for none
    /// [default: that of `dril-pipe.toml`]
    #[arg(long = "remote", value_name = "URL")]
    pub url: Option<String>,
}

/// What `run` does with the shared cache.
#[derive(Debug, Args)]
pub(in crate::cli) struct RemoteModeArgs {
    /// What to do with the shared cache [default: that of `dril-pipe.toml`, else `read`]
    #[arg(long = "remote-mode", value_name = "MODE", value_enum)]
    mode: Option<RemoteMode>,
}

impl RemoteModeArgs {
    /// What was asked for.
    pub fn mode(&self) -> Option<Mode> {
        self.mode.map(|mode| match mode {
            RemoteMode::Read => Mode::Read,
            RemoteMode::Write => Mode::Write,
            RemoteMode::ReadWrite => Mode::ReadWrite,
        })
    }
}

#[derive(Clone, Copy, Debug, ValueEnum)]
enum RemoteMode {
    /// Take results from it
    Read,
    /// Give new results to it
    Write,
    /// Both
    ReadWrite,
}

/// Which results to move or compare.
#[derive(Debug, Args)]
pub(in crate::cli) struct TransferArgs {
    /// Only the results of this pipeline file
    #[arg(value_name = "FILE")]
    file: Option<PathBuf>,
    /// The profile of the pipeline file; without it, the first one
    #[arg(short, long, value_name = "NAME", requires = "file")]
    profile: Option<String>,
    /// Change a value of the pipeline, as in `--set dril.total_timesteps=98304`; may be given several times
    #[arg(short, long, value_name = "PATH=VALUE", requires = "file")]
    set: Vec<String>,
    #[command(flatten)]
    pub remote: RemoteArgs,
    #[command(flatten)]
    pub store: StoreArgs,
    /// Print as JSON
    #[arg(long)]
    pub json: bool,
}

impl TransferArgs {
    /// The pipeline whose results are meant; `None` for all.
    pub fn pipeline(&self) -> Option<PipelineArgs> {
        let file = self.file.clone()?;
        Some(PipelineArgs { file, profile: self.profile.clone(), set: self.set.clone() })
    }
}
