//! `dril-pipe plan`: what would run, and why. Changes nothing.

mod rows;

use std::process::ExitCode;

use dril_stage_api::Registry;
use serde_json::{Value, json};

use super::forecast::OnCluster;
use crate::cli::args::PlanArgs;
use crate::cli::executor::{self, Cluster};
use crate::cli::names::Names;
use crate::cli::terminal::{Style, Terminal, count, estimate, print};
use crate::cli::{columns, pipeline, shared, warnings, why};
use crate::error::Error;
use crate::exec::Options;
use crate::plan::{self, Counts, Estimates, Plan, Verdict, Warning};
use crate::resolve::StageIndex;
use crate::session;
use crate::store::Store;

pub(in crate::cli) fn main(args: &PlanArgs, registry: &Registry) -> Result<ExitCode, Error> {
    let session = pipeline::session(&args.pipeline, &args.store, registry)?;
    let session = session.selection(args.select.selection());
    let loaded = session.load()?;
    let cluster =
        executor::cluster(&args.executor, shared::settings(Some(&args.pipeline.file), Some(registry))?)?;
    let plan = loaded.plan()?;
    let warnings = warnings::show(&loaded);
    print_plan(&plan, warnings, session.store(), (args.json, args.all), cluster.as_ref())?;
    Ok(ExitCode::SUCCESS)
}

/// Prints a plan for this machine.
pub(super) fn show(plan: &Plan<'_>, warnings: &[Warning], store: &Store, json: bool) -> Result<(), Error> {
    print_plan(plan, warnings, store, (json, false), None)
}

fn print_plan(
    plan: &Plan<'_>,
    warnings: &[Warning],
    store: &Store,
    (json, all): (bool, bool),
    cluster: Option<&Cluster>,
) -> Result<(), Error> {
    let estimates = Estimates::of(plan, store)?;
    let forecast = cluster.map(|cluster| OnCluster::of(plan, &estimates, cluster));
    if json {
        let mut value = as_json(plan, &estimates);
        value["warnings"] = json!(warnings);
        if let Some(forecast) = forecast {
            value["forecast"] = forecast.json(plan);
        }
        print(&format!("{value:#}\n"))
    } else {
        let forecast = forecast.map(|forecast| forecast.text(plan)).unwrap_or_default();
        print(&(table(plan, &estimates, all, Terminal::stdout()) + &forecast))
    }
}

fn table(plan: &Plan<'_>, estimates: &Estimates, all: bool, terminal: Terminal) -> String {
    let names = Names::new(plan.graph);
    let rows: Vec<Vec<String>> = rows::rows(plan, &names, all)
        .into_iter()
        .map(|row| vec![names.group(&row.stages), row.verdict.to_owned(), row.why()])
        .collect();
    let paint = |column, cell: String| match (column, cell.trim_end()) {
        (1, "run") => terminal.paint(Style::Notable, &cell),
        (1, _) => terminal.paint(Style::Quiet, &cell),
        _ => cell,
    };
    let mut text = heading(plan, terminal);
    text += &columns::render(&rows, terminal.width.unwrap_or(usize::MAX), &paint);
    if !rows.is_empty() {
        text.push('\n');
    }
    for note in session::cut_names(plan.graph) {
        text += &format!("note: {note}\n");
    }
    let width = terminal.width.unwrap_or(usize::MAX);
    text + &columns::wrap(&(summary(plan) + &time_left(plan, estimates)), width).join("\n") + "\n"
}

fn heading(plan: &Plan<'_>, terminal: Terminal) -> String {
    let title = format!("{}, profile {}", plan.graph.pipeline, plan.graph.profile);
    let stages = count(plan.graph.stages.node_count(), "stage");
    format!("{}: {stages}\n\n", terminal.paint(Style::Strong, &title))
}

fn summary(plan: &Plan<'_>) -> String {
    let Counts { cached, run, depends } = plan.counts();
    if run + depends == 0 {
        return format!("nothing to run: {} cached", count(cached, "stage"));
    }
    let mut text = format!("{} to run", count(run, "stage"));
    if depends > 0 {
        text += &format!(", {depends} downstream (they run if their inputs change)");
    }
    text + &format!(", {cached} cached")
}

/// Estimate of the time for all stale stages, from earlier runs; nothing for less than a second.
fn time_left(plan: &Plan<'_>, estimates: &Estimates) -> String {
    let threads = Options::default().threads;
    let (time, unknown) = estimates.together(plan, threads, |stage| is_stale(plan, stage));
    if time.as_secs() == 0 {
        return String::new();
    }
    let besides = if unknown > 0 { format!(", and {unknown} without an estimate") } else { String::new() };
    format!("; about {} on {}{besides}", estimate(time), count(threads, "thread"))
}

fn is_stale(plan: &Plan<'_>, stage: StageIndex) -> bool {
    !matches!(plan.verdict(stage), Some(Verdict::Cached { .. }))
}

fn as_json(plan: &Plan<'_>, estimates: &Estimates) -> Value {
    let id = |index: &StageIndex| plan.graph.stages.node_weight(*index).map(|stage| stage.id.to_string());
    let stages: Vec<Value> = plan
        .steps
        .iter()
        .map(|(index, verdict)| {
            let mut entry = match verdict {
                Verdict::Cached { key, .. } => json!({ "verdict": "cached", "key": key.hex() }),
                Verdict::Run { key, why } => {
                    json!({ "verdict": "run", "key": key.hex(), "why": reasons(why) })
                }
                Verdict::DependsOn { stages, why } => {
                    let stages: Vec<_> = stages.iter().filter_map(id).collect();
                    json!({ "verdict": "depends-on", "depends_on": stages, "why": reasons(why) })
                }
            };
            if let Some(stage) = plan.graph.stages.node_weight(*index) {
                entry["stage"] = json!(*stage.id);
                entry["kind"] = json!(stage.kind.name());
                if let Some(takes) = estimates.stage(*index) {
                    entry["estimate"] = json!(takes.as_secs_f64());
                }
            }
            entry
        })
        .collect();
    let Counts { cached, run, depends } = plan.counts();
    json!({
        "pipeline": plan.graph.pipeline,
        "profile": plan.graph.profile,
        "counts": { "cached": cached, "run": run, "depends_on": depends },
        "notes": session::cut_names(plan.graph),
        "stages": stages,
    })
}

fn reasons(reasons: &[plan::Reason]) -> Vec<Value> {
    reasons.iter().map(why::json).collect()
}
