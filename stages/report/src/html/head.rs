//! The head of the report: title, warnings and progress.

use std::collections::BTreeSet;

use dril_stage_api::StageError;
use dril_stage_api::outcome::{PipelineOutcome, State};
use maud::{Markup, html};

use super::{count, duration, findings};

/// The head of the page.
pub(crate) fn head(outcome: &PipelineOutcome) -> Result<Markup, StageError> {
    let of = |fits: fn(&State) -> bool| outcome.stages.iter().filter(|stage| fits(&stage.state)).count();
    let (done, failed) = (of(|state| *state == State::Done), of(|state| matches!(state, State::Failed(_))));
    let open = outcome.stages.len() - done - failed;
    let seconds: f64 = outcome.stages.iter().filter_map(|stage| stage.seconds).sum();
    let verdicts = findings::counts(outcome)?;
    Ok(html! {
        h1 { (outcome.pipeline) }
        p class="quiet" { "Profile " code { (outcome.profile) } ", " (count(outcome.stages.len(), "stage")) "." }
        @for warning in warnings(outcome, failed, open)? { p class="warn" { (warning) } }
        dl class="facts" {
            div { dt { "stages up to date" } dd { (done) " of " (outcome.stages.len()) } }
            @if failed > 0 { div { dt { "failed" } dd { (failed) } } }
            @if open > 0 { div { dt { "still to run" } dd { (open) } } }
            div { dt { "compute time" } dd { (duration(seconds)) } }
            @if let Some(verdicts) = verdicts {
                @for (name, number) in verdicts { div { dt { "claims: " (name) } dd { (number) } } }
            }
        }
        @let made_with = made_with(outcome);
        @if !made_with.is_empty() { p class="quiet" { "Made with " (made_with.join("; ")) "." } }
    })
}

/// Warnings that a reader must see before any number.
fn warnings(outcome: &PipelineOutcome, failed: usize, open: usize) -> Result<Vec<String>, StageError> {
    let mut warnings = Vec::new();
    if let Some(full) = outcome.first_profile.as_ref().filter(|full| **full != outcome.profile) {
        warnings.push(format!(
            "Profile {}, not {full}: sizes are reduced, so the numbers are not those of the full experiment.",
            outcome.profile
        ));
    }
    if failed > 0 {
        warnings.push(format!("{} failed; their results are missing here.", count(failed, "stage")));
    }
    if open > 0 {
        let are = if open == 1 { "is" } else { "are" };
        warnings
            .push(format!("{} {are} not up to date; their results are missing here.", count(open, "stage")));
    }
    if findings::rest_on_one_training(outcome)? {
        let text =
            "One training per cell: differences hold for these policies, not for the methods in general.";
        warnings.push(text.to_owned());
    }
    Ok(warnings)
}

/// Distinct programs, platforms and libraries of all results.
fn made_with(outcome: &PipelineOutcome) -> Vec<String> {
    let all: BTreeSet<(&String, &String)> =
        outcome.stages.iter().flat_map(|stage| &stage.made_with).collect();
    all.into_iter().map(|(what, version)| format!("{what} {version}")).collect()
}
