//! Arguments of `cache`: looking after the store.

use std::path::PathBuf;
use std::time::Duration;

use clap::{Args, Subcommand};

use super::StoreArgs;
use crate::spec::limits::parse_size;

#[derive(Debug, Args)]
pub(in crate::cli) struct CacheArgs {
    #[command(subcommand)]
    pub command: CacheCommand,
}

/// What to do with the store.
#[derive(Debug, Subcommand)]
pub(in crate::cli) enum CacheCommand {
    /// Hash every content and read every record: is the store what it says?
    Verify(VerifyArgs),
    /// Remove results that are old or too many, and leftovers; never what a running process uses
    Gc(GcArgs),
    /// Show what takes room
    Du(DuArgs),
    /// Write a run with its results and their provenance into one archive (a Workflow Run RO-Crate)
    Export(ExportArgs),
    /// Refill the store from an archive; takes only what is what it says
    Import(ImportArgs),
}

#[derive(Debug, Args)]
pub(in crate::cli) struct VerifyArgs {
    #[command(flatten)]
    pub store: StoreArgs,
    /// Move what is damaged out of the way, so that it is made again when it is needed
    #[arg(long)]
    pub repair: bool,
    /// Print as JSON
    #[arg(long)]
    pub json: bool,
}

#[derive(Debug, Args)]
pub(in crate::cli) struct GcArgs {
    /// Keep the results of these pipeline files (all profiles) and lock files
    #[arg(long, value_name = "FILE")]
    pub keep: Vec<PathBuf>,
    /// Remove the least recently used results until the contents fit, as in `20G`
    #[arg(long, value_name = "SIZE", value_parser = parse_size)]
    pub max_size: Option<u64>,
    /// Remove results, checkpoints and logs that nobody used for longer, as in `30d`
    #[arg(long, value_name = "TIME", value_parser = super::time)]
    pub older_than: Option<Duration>,
    /// Only say what would be removed
    #[arg(short = 'n', long)]
    pub dry_run: bool,
    #[command(flatten)]
    pub store: StoreArgs,
    /// Print as JSON
    #[arg(long)]
    pub json: bool,
}

#[derive(Debug, Args)]
pub(in crate::cli) struct DuArgs {
    #[command(flatten)]
    pub store: StoreArgs,
    /// Print as JSON
    #[arg(long)]
    pub json: bool,
}

#[derive(Debug, Args)]
pub(in crate::cli) struct ExportArgs {
    /// The run, as `runs` lists it
    #[arg(value_name = "RUN", default_value = "last")]
    pub run: String,
    /// The archive [default: `<pipeline>-<profile>.crate.zip`]
    #[arg(short, long, value_name = "FILE")]
    pub out: Option<PathBuf>,
    #[command(flatten)]
    pub store: StoreArgs,
    /// Print as JSON
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
    /// Print as JSON
    #[arg(long)]
    pub json: bool,
}
