//! A run's events as lines of JSON in its folder, for whoever looks at the run later. Version 1; `at` is in seconds since
//! the run began. Progress is left out.

use std::time::{Duration, Instant};

use serde_json::{Value, json};

use super::Event;
use crate::resolve::{Graph, StageIndex};
use crate::store::{Run, StoreError};

/// Lines are written at most this often, and at the end.
const PAUSE: Duration = Duration::from_millis(100);

/// Gathers lines and writes them now and then.
#[derive(Debug)]
pub(super) struct Journal {
    began: Instant,
    written: Instant,
    lines: Vec<u8>,
}

impl Journal {
    pub fn new(began: Instant) -> Self {
        Self { began, written: began, lines: Vec::new() }
    }

    /// Takes an event down.
    pub fn note(&mut self, graph: &Graph, event: &Event) {
        if let Some(mut line) = line(graph, event) {
            line["at"] = json!(self.began.elapsed().as_millis() as f64 / 1000.0);
            self.lines.extend_from_slice(line.to_string().as_bytes());
            self.lines.push(b'\n');
        }
    }

    /// Writes what has gathered, if it is time or `now`.
    ///
    /// # Errors
    /// The store cannot be written.
    pub fn write(&mut self, run: &Run, now: bool) -> Result<(), StoreError> {
        if !self.lines.is_empty() && (now || self.written.elapsed() >= PAUSE) {
            run.append_events(&self.lines)?;
            self.lines.clear();
            self.written = Instant::now();
        }
        Ok(())
    }
}

fn line(graph: &Graph, event: &Event) -> Option<Value> {
    let id = |stage: &StageIndex| graph.stages[*stage].id.as_ref().to_owned();
    Some(match event {
        Event::Progressed { .. } => return None,
        Event::Started { stages, threads } => {
            json!({ "event": "run-started", "version": 1, "stages": stages, "threads": threads })
        }
        Event::Cached { stage, key } => json!({ "event": "cached", "stage": id(stage), "key": key }),
        Event::Waiting { stage } => json!({ "event": "waiting", "stage": id(stage) }),
        Event::StageStarted { stage, key, why } => {
            json!({ "event": "started", "stage": id(stage), "key": key, "why": why })
        }
        Event::StageFinished { stage, took } => {
            json!({ "event": "finished", "stage": id(stage), "seconds": took.as_secs_f64() })
        }
        Event::StageFailed { stage, error, .. } => {
            json!({ "event": "failed", "stage": id(stage), "error": error })
        }
        Event::Skipped { stage, because } => {
            json!({ "event": "skipped", "stage": id(stage), "because": id(because) })
        }
        Event::Stopping => json!({ "event": "stopping" }),
        Event::Stopped { stage } => json!({ "event": "stopped", "stage": id(stage) }),
        Event::Finished { outcome } => json!({
            "event": "run-finished", "cached": outcome.cached, "ran": outcome.ran, "failed": outcome.failed,
            "skipped": outcome.skipped, "stopped": outcome.stopped, "seconds": outcome.took.as_secs_f64(),
        }),
    })
}
