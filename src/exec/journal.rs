//! Passes the events of a run to the reporter and writes them to `events.jsonl` in the run's folder, one JSON object per line,
//! for `status`, `runs` and `explain`. Format version 1; `at` is in seconds since the run began. Progress is not written.

use std::collections::BTreeSet;
use std::sync::Arc;
use std::time::{Duration, Instant};

use serde::Serialize;
use serde_json::{Value, json};

use super::event::{Event, RunOutcome};
use super::in_order::InOrder;
use super::options::Options;
use crate::plan;
use crate::resolve::{Graph, StageIndex};
use crate::store::{Fingerprint, Key, Run, Store, StoreError};

/// Shortest time between two writes of gathered lines.
const WRITE_INTERVAL: Duration = Duration::from_millis(100);

/// Emits events, and owns the run's folder.
pub(super) struct Journal<'a, 's> {
    graph: &'a Graph,
    sink: &'s mut dyn FnMut(&Event),
    run: Option<Arc<Run>>,
    began: Instant,
    written: Instant,
    lines: Vec<u8>,
    order: InOrder,
}

impl<'a, 's> Journal<'a, 's> {
    pub fn new(graph: &'a Graph, began: Instant, sink: &'s mut dyn FnMut(&Event)) -> Self {
        Self { graph, sink, run: None, began, written: began, lines: Vec::new(), order: InOrder::default() }
    }

    /// Emits an event when it is its turn. It is written once the run has a folder.
    pub fn emit(&mut self, event: &Event) {
        // There can be thousands of these at a time, and none of them has to wait.
        if let Event::Cached { .. } = event {
            return self.emit_now(event);
        }
        let graph = self.graph;
        let is_fed_by = |stage: StageIndex, open: &BTreeSet<StageIndex>| {
            plan::feeding(graph, stage).any(|feeder| open.contains(&feeder))
        };
        for event in self.order.next(&is_fed_by, event) {
            self.emit_now(&event);
        }
    }

    fn emit_now(&mut self, event: &Event) {
        if self.run.is_some() {
            self.write_line(event);
        }
        (self.sink)(event);
    }

    /// The run's folder, if it has one.
    pub fn run(&self) -> Option<&Arc<Run>> {
        self.run.as_ref()
    }

    /// Creates the run's folder, when the first stage starts: a run with nothing to do leaves no trace. `done` are the cache
    /// hits that were emitted until then.
    pub fn open(
        &mut self,
        store: &Store,
        options: &Options,
        done: &[(StageIndex, &Key)],
    ) -> Result<Arc<Run>, StoreError> {
        let threads = options.threads.max(1);
        let stages = self.graph.stages.node_count();
        let mut manifest = json!({
            "version": 1, "pipeline": self.graph.pipeline, "profile": self.graph.profile, "stages": stages,
            "fingerprint": Fingerprint::current(),
        });
        for (name, value) in &options.about {
            manifest[name] = value.clone();
        }
        let run = Arc::new(store.begin_run(&manifest)?);
        self.run = Some(Arc::clone(&run));
        self.write_line(&Event::Started { stages, threads });
        for (stage, key) in done {
            self.write_line(&Event::Cached { stage: *stage, key: **key });
        }
        Ok(run)
    }

    /// Emits the end and writes the remaining lines.
    pub fn finish(mut self, outcome: &RunOutcome) -> Result<Option<Arc<Run>>, StoreError> {
        for event in self.order.rest() {
            self.emit_now(&event);
        }
        self.emit(&Event::Finished { outcome: outcome.clone() });
        self.write(true)?;
        Ok(self.run)
    }

    /// Writes the gathered lines, if `now` or if the last write is long enough ago.
    pub fn write(&mut self, now: bool) -> Result<(), StoreError> {
        if let Some(run) = self.run.as_ref().filter(|_| !self.lines.is_empty())
            && (now || self.written.elapsed() >= WRITE_INTERVAL)
        {
            run.append_events(&self.lines)?;
            self.lines.clear();
            self.written = Instant::now();
        }
        Ok(())
    }

    fn write_line(&mut self, event: &Event) {
        let at = self.began.elapsed().as_millis() as f64 / 1000.0;
        // There can be thousands of these at a time.
        if let Event::Cached { stage, key } = event {
            let stage: &str = &self.graph.stages[*stage].id;
            let start = self.lines.len();
            match serde_json::to_writer(&mut self.lines, &CachedLine { at, event: "cached", key, stage }) {
                Ok(()) => self.lines.push(b'\n'),
                Err(_) => self.lines.truncate(start),
            }
        } else if let Some(mut line) = line(self.graph, event) {
            line["at"] = json!(at);
            self.lines.extend_from_slice(line.to_string().as_bytes());
            self.lines.push(b'\n');
        }
    }
}

/// The line of a cache hit.
#[derive(Serialize)]
struct CachedLine<'a> {
    at: f64,
    event: &'static str,
    key: &'a Key,
    stage: &'a str,
}

fn line(graph: &Graph, event: &Event) -> Option<Value> {
    let id = |stage: &StageIndex| graph.stages[*stage].id.as_ref().to_owned();
    Some(match event {
        Event::Progressed { .. } | Event::Cached { .. } => return None,
        Event::Started { stages, threads } => {
            json!({ "event": "run-started", "version": 1, "stages": stages, "threads": threads })
        }
        Event::Waiting { stage } => json!({ "event": "waiting", "stage": id(stage) }),
        Event::StageStarted { stage, key, why } => {
            json!({ "event": "started", "stage": id(stage), "key": key, "why": why })
        }
        Event::StageFinished { stage, took } => {
            json!({ "event": "finished", "stage": id(stage), "seconds": took.as_secs_f64() })
        }
        Event::StageFailed { stage, failure, .. } => json!({
            "event": "failed", "stage": id(stage), "error": failure.to_string(),
            "cause": failure.kind().name(),
        }),
        Event::Retrying { stage, retry, failure, pause, .. } => json!({
            "event": "retrying", "stage": id(stage), "retry": retry, "error": failure.to_string(),
            "seconds": pause.as_secs_f64(),
        }),
        Event::Skipped { stage, because } => {
            json!({ "event": "skipped", "stage": id(stage), "because": id(because) })
        }
        Event::Stopping { out_of_time } => json!({ "event": "stopping", "out_of_time": out_of_time }),
        Event::Stopped { stage } => json!({ "event": "stopped", "stage": id(stage) }),
        Event::Finished { outcome } => json!({
            "event": "run-finished", "cached": outcome.cached, "ran": outcome.ran, "failed": outcome.failed,
            "skipped": outcome.skipped, "stopped": outcome.stopped, "seconds": outcome.took.as_secs_f64(),
        }),
    })
}
