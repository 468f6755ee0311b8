//! Arguments of `cache`.

use std::path::PathBuf;
use std::time::Duration;

use clap::{Args, Subcommand};

use super::{StoreArgs, TransferArgs};
use crate::spec::limits::parse_size;

#[derive(Debug, Args)]
pub(in crate::cli) struct CacheArgs {
    #[command(subcommand)]
    pub command: CacheCommand,
}

/// The subcommands of `cache`.
#[derive(Debug, Subcommand)]
pub(in crate::cli) enum CacheCommand {
    /// Hash every blob and check every record
    Verify(VerifyArgs),
    /// Remove unused and old results, and leftovers of crashed runs; never anything that a running process uses
    Gc(GcArgs),
    /// Show disk usage by folder and by stage
    Du(DuArgs),
    /// Check that a file system provides what a cache needs, on this machine and between two
    Doctor(DoctorArgs),
    /// Write a run with its results and provenance to an archive (a Workflow Run RO-Crate)
    Export(ExportArgs),
    /// Add the contents of an archive to the cache; every digest and key is checked
    Import(ImportArgs),
    /// Give results to a shared cache; continues where an earlier push was interrupted
    Push(TransferArgs),
    /// Take results from a shared cache; takes only content that matches its digest
    Pull(TransferArgs),
    /// Show which results are in a shared cache, and which differ from those here
    RemoteStatus(TransferArgs),
}

#[derive(Debug, Args)]
pub(in crate::cli) struct VerifyArgs {
    #[command(flatten)]
    pub store: StoreArgs,
    /// Move damaged files to quarantine, so that they are rebuilt when needed
    #[arg(long)]
    pub repair: bool,
    /// Print JSON
    #[arg(long)]
    pub json: bool,
}

#[derive(Debug, Args)]
pub(in crate::cli) struct GcArgs {
    /// Keep the results of this pipeline file (all profiles) or lock file; can be repeated
    #[arg(long, value_name = "FILE")]
    pub keep: Vec<PathBuf>,
    /// Remove the least recently used results, checkpoints and logs until the cache is not larger than this, as in `20G`
    #[arg(long, value_name = "SIZE", value_parser = parse_size)]
    pub max_size: Option<u64>,
    /// Remove results, checkpoints and logs that have not been used for this long, as in `30d`
    #[arg(long, value_name = "TIME", value_parser = super::time)]
    pub older_than: Option<Duration>,
    /// Only show what would be removed
    #[arg(short = 'n', long)]
    pub dry_run: bool,
    #[command(flatten)]
    pub store: StoreArgs,
    /// Print JSON
    #[arg(long)]
    pub json: bool,
}

#[derive(Debug, Args)]
pub(in crate::cli) struct DuArgs {
    #[command(flatten)]
    pub store: StoreArgs,
    /// Print JSON
    #[arg(long)]
    pub json: bool,
}

#[derive(Debug, Args)]
pub(in crate::cli) struct DoctorArgs {
    /// A folder of the file system, such as the cache
    #[arg(value_name = "DIR")]
    pub folder: PathBuf,
    /// Take part in a measurement from another machine: start this there first, then `cache doctor DIR` here
    #[arg(long, conflicts_with = "json")]
    pub peer: bool,
    /// Print JSON
    #[arg(long)]
    pub json: bool,
}

#[derive(Debug, Args)]
pub(in crate::cli) struct ExportArgs {
    /// The run, as listed by `runs`
    #[arg(value_name = "RUN", default_value = "last")]
    pub run: String,
    /// The archive [default: `<pipeline>-<profile>.crate.zip`]
    #[arg(short, long, value_name = "FILE")]
    pub out: Option<PathBuf>,
    #[command(flatten)]
    pub store: StoreArgs,
    /// Print JSON
    #[arg(long)]
    pub json: bool,
}

#[derive(Debug, Args)]
pub(in crate::cli) struct ImportArgs {
    /// The archive
    #[arg(value_name = "FILE")]
    pub archive: PathBuf,
    #[command(flatten)]
    pub store: StoreArgs,
    /// Print JSON
    #[arg(long)]
    pub json: bool,
}
