//! Runs jobs inside this process: no isolation, no log, and stages cannot be killed. For tests of the engine, where a process
//! per stage would take longer than the stages themselves.

use std::io::{self, Write};
use std::panic::{AssertUnwindSafe, catch_unwind};

use dril_stage_api::{Message, Registry, StageError};

use super::checkpoints;
use super::failure::Failure;
use super::runner::{Exit, Launch, Runner};
use super::stage::perform;

/// Runs jobs with the kinds of a registry, in the engine's worker threads.
#[derive(Clone, Debug)]
pub struct InlineRunner {
    /// The kinds.
    pub registry: Registry,
}

impl Runner for InlineRunner {
    fn run(&self, launch: &Launch<'_>, on_message: &mut dyn FnMut(Message)) -> Result<Exit, Failure> {
        if !checkpoints::discard(launch)? {
            return Ok(Exit::Stopped);
        }
        let mut messages = Lines { part: Vec::new(), on_message };
        let performed = catch_unwind(AssertUnwindSafe(|| {
            perform(launch.job, &self.registry, launch.stop, &mut messages, None)
        }));
        match performed {
            Ok(Ok(())) => Ok(Exit::Done),
            Ok(Err(StageError::Cancelled)) => Ok(Exit::Stopped),
            Ok(Err(error)) => Err(Failure::Stage(error.to_string())),
            Err(_) => Err(Failure::Stage("the stage panicked".to_owned())),
        }
    }
}

struct Lines<'a> {
    part: Vec<u8>,
    on_message: &'a mut dyn FnMut(Message),
}

impl Write for Lines<'_> {
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        for &byte in bytes {
            if byte == b'\n' {
                let message = std::str::from_utf8(&self.part).ok().and_then(Message::from_line);
                message.into_iter().for_each(&mut *self.on_message);
                self.part.clear();
            } else {
                self.part.push(byte);
            }
        }
        Ok(bytes.len())
    }

    fn flush(&mut self) -> io::Result<()> {
        Ok(())
    }
}
