//! The kind `select`: the best of several policies by their evaluations.

use std::cmp::Ordering;
use std::collections::BTreeSet;

use dril_stage_api::{Artifact, Ctx, Describe, FanIns, InputItem, Ports, Problems, Stage, StageError};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use crate::number::precise;
use crate::samples::{self, Sample, describe, summarise, unique};
use crate::stats::Summary;

/// The type of what is chosen from: the same as that of the package that trains policies.
const POLICY: Artifact = Artifact::new("policy", "safetensors");
/// The name of the input with the policies.
const CANDIDATES: &str = "candidates";
/// The columns that follow the labels in the ranking.
const VALUES: [&str; 5] = ["mean", "std", "episodes", "diverged", "chosen"];

/// The criterion.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Deserialize, Serialize, JsonSchema)]
#[serde(rename_all = "kebab-case")]
pub enum By {
    /// The highest mean score.
    #[default]
    Mean,
}

/// Parameters of [`Select`].
#[derive(Clone, Debug, Default, PartialEq, Deserialize, Serialize, JsonSchema)]
#[serde(deny_unknown_fields, default)]
pub struct SelectParams {
    /// The criterion.
    pub by: By,
    /// Decimals of the scores, 0 to 6. The ranking has two more, as every CSV file.
    #[serde(skip_serializing_if = "crate::caption::is_default")]
    pub decimals: u8,
}

/// Selects the policy with the best evaluation. Ties go to the first in the order of the matrix.
///
/// Inputs: `candidates`, any number of policies, and `scores`, one evaluation for each; the two are matched by equal
/// labels, whatever their order.
///
/// Outputs: `policy`, a copy of the chosen file, byte for byte; and `ranking`, a CSV file with the labels in
/// alphabetical order, then `mean,std,episodes,diverged,chosen`, the best candidate first. `diverged` is 1 for a candidate
/// whose training diverged: its last finite weights were evaluated, and it can be chosen like any other. The comparison
/// uses all digits of the means, of which the ranking shows `decimals` + 2 decimals.
pub struct Select;

impl Describe for Select {
    const KIND: &'static str = "select";
    const REVISION: u32 = 2;
    const ABOUT: &'static str = "selects the policy with the best evaluation";
    const SEEDED: bool = false;
    type Params = SelectParams;

    fn check(params: &SelectParams, problems: &mut Problems) {
        crate::caption::check_decimals(params.decimals, problems);
    }

    fn check_labels(_: &SelectParams, inputs: &FanIns<'_>, problems: &mut Problems) {
        for port in [CANDIDATES, samples::PORT] {
            samples::check_unique(port, inputs, problems);
        }
    }

    fn ports(_: &SelectParams) -> Ports {
        Ports::new()
            .many(CANDIDATES, POLICY, "the policies to choose from")
            .many(samples::PORT, Artifact::SCORES, "one evaluation of each candidate, with the same labels")
            .output("policy", POLICY, "safetensors", "the chosen policy, byte for byte")
            .output("ranking", Artifact::FILE, "csv", "all candidates, the best first")
    }
}

impl Stage for Select {
    type Kind = Self;

    fn run(params: &SelectParams, ctx: &mut Ctx<'_>) -> Result<(), StageError> {
        let candidates = ctx.inputs(CANDIDATES);
        unique(CANDIDATES, &candidates)?;
        let samples = samples::read(ctx)?;
        let ranked = rank(matched(&candidates, &samples)?, params.by);
        let Some(best) = ranked.first() else {
            return Err(StageError::Port(format!(
                "input `{CANDIDATES}` has no artifact, expected at least one"
            )));
        };
        let path = best.candidate.path;
        let bytes = std::fs::read(path).map_err(StageError::io("cannot read", path))?;
        ctx.write_output("policy", bytes)?;
        ctx.write_output("ranking", ranking(&ranked, params.decimals)?)
    }
}

/// A candidate and what its evaluation says.
struct Judged<'a> {
    candidate: InputItem<'a>,
    summary: Summary,
    diverged: bool,
}

/// Each candidate with its evaluation, in the order of the candidates.
fn matched<'a>(candidates: &[InputItem<'a>], samples: &[Sample<'a>]) -> Result<Vec<Judged<'a>>, StageError> {
    if let Some(stray) = samples.iter().find(|s| candidates.iter().all(|c| c.labels != s.item.labels)) {
        return Err(unmatched(samples::PORT, &stray.item, CANDIDATES, candidates.iter()));
    }
    let judge = |candidate: &InputItem<'a>| {
        let sample = samples.iter().find(|sample| sample.item.labels == candidate.labels);
        let Some(sample) = sample else {
            let items = samples.iter().map(|sample| &sample.item);
            return Err(unmatched(CANDIDATES, candidate, samples::PORT, items));
        };
        let summary = summarise(&sample.scores, &sample.item)?;
        Ok(Judged { candidate: *candidate, summary, diverged: sample.diverged })
    };
    candidates.iter().map(judge).collect()
}

fn unmatched<'a>(
    port: &str,
    item: &InputItem<'_>,
    other: &str,
    items: impl Iterator<Item = &'a InputItem<'a>>,
) -> StageError {
    let seen: Vec<String> = items.map(|item| format!("({})", describe(item.labels))).collect();
    let message = format!(
        "the item with labels ({}) has no counterpart at `{other}`, expected one with the same labels; there are {}; \
         wire both inputs over the same axes",
        describe(item.labels),
        seen.join(", ")
    );
    StageError::input(port, item.path, message)
}

/// The best first. The sort is stable, so equals keep the order of the matrix.
fn rank(mut judged: Vec<Judged<'_>>, by: By) -> Vec<Judged<'_>> {
    let value = |judged: &Judged<'_>| match by {
        By::Mean => judged.summary.mean,
    };
    // Summaries are finite, so every two of them compare.
    judged.sort_by(|a, b| value(b).partial_cmp(&value(a)).unwrap_or(Ordering::Equal));
    judged
}

fn ranking(ranked: &[Judged<'_>], decimals: u8) -> Result<Vec<u8>, StageError> {
    let axes: BTreeSet<&str> =
        ranked.iter().flat_map(|judged| judged.candidate.labels.keys()).map(String::as_str).collect();
    if let Some(axis) = axes.iter().find(|axis| VALUES.contains(axis)) {
        let message =
            format!("an axis is called `{axis}`, which is a column of the ranking; rename the axis");
        return Err(StageError::failed(message));
    }
    ranking_text(ranked, &axes, decimals).map_err(StageError::failed)
}

fn ranking_text(
    ranked: &[Judged<'_>],
    axes: &BTreeSet<&str>,
    decimals: u8,
) -> Result<Vec<u8>, Box<dyn std::error::Error>> {
    let mut writer = csv::Writer::from_writer(Vec::new());
    writer.write_record(axes.iter().copied().chain(VALUES))?;
    for (n, Judged { candidate, summary, diverged }) in ranked.iter().enumerate() {
        let labels = axes.iter().map(|axis| candidate.labels.get(*axis).map_or("", String::as_str));
        let (mean, std) = (precise(summary.mean, decimals), precise(summary.std, decimals));
        let (episodes, diverged) = (summary.episodes.to_string(), u8::from(*diverged).to_string());
        let chosen = (n == 0).to_string();
        writer.write_record(labels.chain([mean.as_str(), &std, &episodes, &diverged, &chosen]))?;
    }
    Ok(writer.into_inner()?)
}
