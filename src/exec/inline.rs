//! Runs jobs in this process: no isolation, no log, and stages that cannot be killed. For tests of the engine, where a
//! process each would cost more than all they do.

use std::io::{self, Write};
use std::panic::{AssertUnwindSafe, catch_unwind};

use dril_stage_api::{Message, Registry, StageError};

use super::runner::{Exit, Launch, Runner};
use super::stage::perform;

/// Runs jobs with the kinds of a registry, in the dispatcher's own threads.
#[derive(Clone, Debug)]
pub struct InlineRunner {
    /// The kinds.
    pub registry: Registry,
}

impl Runner for InlineRunner {
    fn run(&self, launch: &Launch<'_>, hear: &mut dyn FnMut(Message)) -> io::Result<Exit> {
        let mut messages = Lines { part: Vec::new(), hear };
        let performed = catch_unwind(AssertUnwindSafe(|| {
            perform(launch.job, &self.registry, launch.stop, &mut messages)
        }));
        Ok(match performed {
            Ok(Ok(())) => Exit::Done,
            Ok(Err(StageError::Cancelled)) => Exit::Stopped,
            Ok(Err(error)) => Exit::Failed(error.to_string()),
            Err(_) => Exit::Failed("the stage panicked".to_owned()),
        })
    }
}

struct Lines<'a> {
    part: Vec<u8>,
    hear: &'a mut dyn FnMut(Message),
}

impl Write for Lines<'_> {
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        for &byte in bytes {
            if byte == b'\n' {
                let message = std::str::from_utf8(&self.part).ok().and_then(Message::from_line);
                message.into_iter().for_each(&mut *self.hear);
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
