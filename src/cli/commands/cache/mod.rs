//! `dril-pipe cache`: manages the cache.

mod doctor;
mod du;
mod gc;
mod shared;
mod transfer;
mod verify;

use std::process::ExitCode;

use dril_stage_api::Registry;

use crate::cli::args::{CacheArgs, CacheCommand, StoreArgs};
use crate::cli::pipeline;
use crate::cli::terminal::{print_error, shown};
use crate::error::Error;
use crate::fsx;
use crate::plan::key_of_record;
use crate::store::{Key, Record, Store};

pub(in crate::cli) fn main(args: &CacheArgs, registry: &Registry) -> Result<ExitCode, Error> {
    match &args.command {
        CacheCommand::Verify(args) => verify::main(args),
        CacheCommand::Gc(args) => gc::main(args, registry),
        CacheCommand::Du(args) => du::main(args),
        CacheCommand::Doctor(args) => doctor::main(args),
        CacheCommand::Export(args) => transfer::export(args),
        CacheCommand::Import(args) => transfer::import(args),
        CacheCommand::Push(args) => shared::push(args, registry),
        CacheCommand::Pull(args) => shared::pull(args, registry),
        CacheCommand::RemoteStatus(args) => shared::status(args, registry),
    }
}

/// The store of a command that looks after what is there. Where there is nothing, a note says so: its path is probably misspelt.
///
/// # Errors
/// Its path is not a folder.
fn store(args: &StoreArgs) -> Result<Store, Error> {
    let store = pipeline::store(args)?;
    if fsx::entry(store.root())?.is_none() {
        let root = shown(store.root());
        print_error(&format!(
            "note: there is no cache in `{root}`; `--cache DIR` or DRIL_PIPE_CACHE names another one\n"
        ));
    }
    Ok(store)
}

/// Computes the key of a record again.
fn key_of(record: &Record) -> Option<Key> {
    key_of_record(record).ok()
}
