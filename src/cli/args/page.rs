//! Arguments of `report`.

use std::path::PathBuf;

use clap::Args;

use super::{PipelineArgs, StoreArgs};

#[derive(Debug, Args)]
pub(in crate::cli) struct ReportArgs {
    #[command(flatten)]
    pub pipeline: PipelineArgs,
    #[command(flatten)]
    pub store: StoreArgs,
    /// The file to write [default: `report.html` in the results folder]
    #[arg(short, long, value_name = "FILE")]
    pub out: Option<PathBuf>,
    /// Compare with an earlier run (`last~1`, or its name as `dril-pipe runs` prints it) or an archive of `cache export`
    #[arg(long, value_name = "RUN|ARCHIVE")]
    pub against: Option<String>,
}
