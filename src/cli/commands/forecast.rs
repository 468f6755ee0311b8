//! What `plan --executor` says about a run on a cluster.

use serde_json::{Value, json};

use crate::cli::executor::{self, Cluster};
use crate::cli::terminal::{count, estimate};
use crate::plan::{Estimates, Forecast, Place, Plan};
use crate::resolve::{StageIndex, StageInstance};
use crate::settings::ClusterSettings;

/// Stages of the critical path that are named.
const NAMED: usize = 12;

/// A forecast for a cluster.
pub(super) struct OnCluster {
    name: String,
    pilots: usize,
    forecast: Forecast,
}

impl OnCluster {
    /// The forecast of a plan.
    pub fn of(plan: &Plan<'_>, estimates: &Estimates, (scheduler, settings): &Cluster) -> Self {
        let forecast =
            Forecast::of(plan, estimates, executor::max_threads(settings), |stage| place(settings, stage));
        Self { name: scheduler.name().to_owned(), pilots: settings.pilots.unwrap_or_default(), forecast }
    }

    /// Its lines; none where nothing would run.
    pub fn text(&self, plan: &Plan<'_>) -> String {
        let Forecast { jobs, beside, times, critical, shortest, stale, unknown } = &self.forecast;
        if *stale == 0 {
            return String::new();
        }
        let jobs = usize::try_from(*jobs).unwrap_or(usize::MAX);
        let mut text = format!(
            "\non {}: {}, {} beside the engine",
            self.name,
            count(jobs, "job"),
            count(*beside, "stage")
        );
        if self.pilots > 0 {
            text += &format!("; fewer jobs where stages fit into one of {}", count(self.pilots, "pilot"));
        }
        text.push('\n');
        if shortest.is_zero() {
            return text
                + "no stage has an estimate, since nothing like it ran before: no time can be forecast\n";
        }
        for (threads, time) in times {
            text += &format!("  about {} on {}\n", estimate(*time), count(*threads, "thread"));
        }
        text += &format!(
            "critical path: about {}, {}: {}\n",
            estimate(*shortest),
            count(critical.len(), "stage"),
            chain(plan, critical)
        );
        if *unknown > 0 {
            text += &format!(
                "{unknown} of {stale} stages have no estimate and count as 0 s: the times are too short\n"
            );
        }
        text + "waiting in the queue of the cluster is not included\n"
    }

    /// As JSON.
    pub fn json(&self, plan: &Plan<'_>) -> Value {
        let Forecast { jobs, beside, times, critical, shortest, stale, unknown } = &self.forecast;
        let times =
            times.iter().map(|(threads, time)| json!({ "threads": threads, "seconds": time.as_secs_f64() }));
        json!({
            "executor": self.name, "jobs": jobs, "beside": beside, "pilots": self.pilots,
            "times": times.collect::<Vec<_>>(), "stages": stale, "unknown": unknown,
            "critical_path": { "seconds": shortest.as_secs_f64(), "stages": names(plan, critical) },
        })
    }
}

fn place(settings: &ClusterSettings, stage: &StageInstance) -> Place {
    match settings.is_local(stage.kind) {
        true => Place::Beside,
        false => Place::Job(settings.of(&stage.name, stage.kind.name()).time),
    }
}

fn names<'g>(plan: &Plan<'g>, stages: &[StageIndex]) -> Vec<&'g str> {
    stages.iter().map(|stage| &*plan.graph.stages[*stage].id).collect()
}

/// The stages of a chain; the middle of a long one is left out.
fn chain(plan: &Plan<'_>, stages: &[StageIndex]) -> String {
    let names = names(plan, stages);
    if names.len() <= NAMED {
        return names.join(" → ");
    }
    let (first, last) = (&names[..NAMED / 2], &names[names.len() - NAMED / 2..]);
    format!("{} → … → {}", first.join(" → "), last.join(" → "))
}
