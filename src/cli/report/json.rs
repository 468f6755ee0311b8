//! Events as JSON lines on stdout, for programs: `event` is the type, `at` the time in seconds since the start. The last event is
//! `ended`, or `error` where the run could not start or continue.

use std::time::Instant;

use serde_json::{Value, json};

use super::{Ending, Reporter};
use crate::cli::terminal::print;
use crate::cli::why;
use crate::error::Error;
use crate::exec::Event;
use crate::plan::{Counts, Plan};
use crate::resolve::{Graph, StageIndex};

/// Prints JSON lines.
pub(super) struct Json<'g> {
    graph: &'g Graph,
    began: Instant,
}

impl<'g> Json<'g> {
    /// `began` is the start of the run.
    pub fn new(graph: &'g Graph, began: Instant) -> Self {
        Self { graph, began }
    }

    fn say(&self, event: &str, mut fields: Value) {
        fields["event"] = json!(event);
        fields["at"] = seconds_since(self.began);
        // A closed pipe must not stop the run.
        let _ = print(&format!("{fields}\n"));
    }

    fn id(&self, stage: StageIndex) -> &str {
        self.graph.stages.node_weight(stage).map_or("", |stage| &stage.id)
    }

    fn stage(&self, event: &str, stage: StageIndex, mut fields: Value) {
        fields["stage"] = json!(self.id(stage));
        self.say(event, fields);
    }
}

impl Reporter for Json<'_> {
    fn planned(&mut self, plan: &Plan<'_>, threads: usize) {
        let Counts { cached, run, depends } = plan.counts();
        let fields = json!({
            "pipeline": self.graph.pipeline, "profile": self.graph.profile, "threads": threads,
            "stages": plan.steps.len(), "cached": cached, "run": run, "depends_on": depends,
        });
        self.say("planned", fields);
    }

    fn event(&mut self, event: &Event) {
        match event {
            // `planned` and `ended` contain more.
            Event::Started { .. } | Event::Finished { .. } => {}
            Event::Cached { stage, key } => self.stage("cached", *stage, json!({ "key": key.hex() })),
            Event::Waiting { stage } => self.stage("waiting", *stage, json!({})),
            Event::StageStarted { stage, key, why } => {
                let why: Vec<Value> = why.iter().map(why::json).collect();
                self.stage("started", *stage, json!({ "key": key.hex(), "why": why }));
            }
            Event::Progressed { stage, progress } => {
                self.stage("progress", *stage, json!(progress));
            }
            Event::StageFinished { stage, took } => {
                self.stage("ran", *stage, json!({ "seconds": took.as_secs_f64() }));
            }
            Event::Retrying { stage, retry, of, failure, pause } => {
                let seconds = pause.as_secs_f64();
                let fields =
                    json!({ "retry": retry, "of": of, "error": failure.to_string(), "seconds": seconds });
                self.stage("retrying", *stage, fields);
            }
            Event::StageFailed { stage, failure, log_tail, log } => {
                let (error, cause) = (failure.to_string(), failure.kind().name());
                let fields = json!({ "error": error, "cause": cause, "log_tail": log_tail, "log": log.to_string_lossy() });
                self.stage("failed", *stage, fields);
            }
            Event::Skipped { stage, because } => {
                self.stage("skipped", *stage, json!({ "because": self.id(*because) }));
            }
            Event::Stopping { out_of_time } => self.say("stopping", json!({ "out_of_time": out_of_time })),
            Event::Stopped { stage } => self.stage("stopped", *stage, json!({})),
        }
    }

    fn ended(&mut self, ending: &Ending<'_>) {
        let outcome = &ending.finished.executed.outcome;
        let mut fields = json!({
            "ran": outcome.ran, "cached": outcome.cached, "failed": outcome.failed,
            "skipped": outcome.skipped, "stopped": outcome.stopped,
            "seconds": outcome.took.as_secs_f64(), "exit_code": ending.exit_code,
        });
        if let Some(published) = &ending.finished.published {
            fields["results"] = json!({
                "folder": published.folder.to_string_lossy(), "files": published.files,
                "earlier": published.earlier, "removed": published.removed,
            });
        }
        if let Some(left) = &ending.finished.remaining {
            let stages: Vec<&str> = left.stages.iter().map(|stage| self.id(*stage)).collect();
            fields["left"] = json!({
                "stages": stages, "seconds": left.time.as_secs_f64(), "unknown": left.unknown,
            });
        }
        if let Some(exchange) = ending.exchange {
            let (taken, given) = (&exchange.taken, &exchange.given);
            fields["remote"] = json!({
                "taken": taken.results(), "bytes_taken": taken.bytes(), "given": given.new,
                "bytes_given": given.bytes, "different": given.different.len(),
            });
        }
        if let Some(error) = &ending.finished.error {
            fields["error"] = json!(error.message());
        }
        self.say("ended", fields);
    }
}

/// The time of an event: seconds since the start.
pub(in crate::cli) fn seconds_since(began: Instant) -> Value {
    json!(began.elapsed().as_millis() as f64 / 1000.0)
}

/// The line of an error that kept the run from starting or continuing.
pub(in crate::cli) fn error_line(error: &Error, began: Instant) -> String {
    let code = error.kind().exit_code();
    let fields = json!({
        "event": "error", "kind": error.kind().name(), "exit_code": code, "error": error.to_string(),
        "at": seconds_since(began),
    });
    format!("{fields}\n")
}
