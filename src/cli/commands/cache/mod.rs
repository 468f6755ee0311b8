//! `dril-pipe cache`: manages the cache.

mod doctor;
mod du;
mod gc;
mod shared;
mod transfer;
mod verify;

use std::process::ExitCode;

use dril_stage_api::Registry;

use crate::cli::args::{CacheArgs, CacheCommand};
use crate::error::Error;
use crate::plan::key_of_record;
use crate::store::{Key, Record};

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

/// Computes the key of a record again.
fn key_of(record: &Record) -> Option<Key> {
    key_of_record(record).ok()
}
