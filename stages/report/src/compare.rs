//! The kind `compare`: the same agents under two or more conditions, on the same tracks, with ratios and paired differences.
//!
//! Episodes on equal tracks are pairs: the difficulty of a track cancels in their differences, so the mean of these is more
//! precise than the difference of two means.

use dril_stage_api::scores::{self, ScoreRow};
use dril_stage_api::{Artifact, Ctx, Describe, FanIns, InputItem, Ports, Problems, Stage, StageError};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use crate::caption::{self, Caption, divergence, statistic};
use crate::markdown::{self, Column, escape};
use crate::number::{fixed, precise};
use crate::samples::{self, PORT};
use crate::score::Score;
use crate::stats::Summary;

/// The columns that follow the labels in the CSV.
const VALUES: [&str; 7] = ["mean", "std", "episodes", "diverged", "ratio", "difference", "difference_error"];

/// Parameters of [`Compare`].
#[derive(Clone, Debug, PartialEq, Deserialize, Serialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct CompareParams {
    /// The title.
    pub title: String,
    /// The profile of the run; printed with the table.
    pub profile: String,
    /// The profile with the sizes of the experiment; at any other the table states that its sizes are reduced. Without it,
    /// these are `full` and `default`, the profile of a file without `profiles`.
    #[serde(default)]
    pub full_profile: Option<String>,
    /// The label whose values are compared.
    pub axis: String,
    /// The value of the label that the others are compared with.
    pub base: String,
    /// Decimals of this run's numbers in the Markdown table, 0 to 6; differences have one more. The CSV has two more.
    #[serde(default)]
    pub decimals: u8,
    /// A sentence to print under the Markdown table.
    #[serde(default)]
    pub note: String,
}

impl CompareParams {
    fn caption(&self) -> Caption<'_> {
        let Self { title, profile, full_profile, note, .. } = self;
        Caption { title, profile, full_profile: full_profile.as_deref(), note }
    }
}

/// Compares evaluations that differ in one label.
///
/// Input: `scores`, evaluations with the label `axis`; those that agree in all other labels are compared, and must have
/// been played on the same list of tracks.
///
/// Outputs: `csv` with the columns `<other labels>,<axis>,mean,std,episodes,diverged,ratio,difference,difference_error`,
/// and `markdown`. `diverged` is 1 where the training of the agent diverged, so that its last finite weights were
/// evaluated. `ratio` is the mean over the base's mean; `difference` is the mean over the tracks of score minus the base's
/// score, and `difference_error` its standard error (empty for a single episode).
pub struct Compare;

impl Describe for Compare {
    const KIND: &'static str = "compare";
    const REVISION: u32 = 4;
    const ABOUT: &'static str = "compares evaluations of the same seeds, with ratio and paired difference";
    const SEEDED: bool = false;
    type Params = CompareParams;

    fn check(params: &CompareParams, problems: &mut Problems) {
        params.caption().check(problems);
        caption::check_decimals(params.decimals, problems);
        for (field, value) in [("axis", &params.axis), ("base", &params.base)] {
            if value.trim().is_empty() {
                problems.add(field, format!("`{field}` is empty, expected a label's name or value"));
            }
        }
        if VALUES.contains(&params.axis.as_str()) {
            let message = format!("`{}` is a column of the table itself, expected a label", params.axis);
            problems.add("axis", message);
        }
    }

    fn check_labels(params: &CompareParams, inputs: &FanIns<'_>, problems: &mut Problems) {
        samples::check_unique(PORT, inputs, problems);
        inputs.require(PORT, &params.axis, "axis", problems);
    }

    fn ports(_: &CompareParams) -> Ports {
        Ports::new()
            .many(PORT, Artifact::SCORES, "the evaluations; they are compared by their labels")
            .output("csv", Artifact::TABLE, "csv", "one row per evaluation")
            .output("markdown", Artifact::TABLE, "md", "the same for people")
    }
}

impl Stage for Compare {
    type Kind = Self;

    fn run(params: &CompareParams, ctx: &mut Ctx<'_>) -> Result<(), StageError> {
        let items = ctx.inputs(PORT);
        samples::unique(PORT, &items)?;
        let evaluations = items.iter().map(|item| read(item, params)).collect::<Result<Vec<_>, _>>()?;
        let names = label_names(&evaluations);
        let lines = lines(&evaluations, params)?;
        ctx.write_output("csv", csv_text(params, &names, &lines).map_err(StageError::failed)?)?;
        ctx.write_output("markdown", page(params, &names, &lines))
    }
}

/// One evaluation at the input.
struct Evaluation<'a> {
    item: InputItem<'a>,
    /// Its value on the axis.
    value: &'a str,
    /// Its other labels.
    others: Vec<(&'a str, &'a str)>,
    rows: Vec<ScoreRow>,
    summary: Summary,
}

impl Evaluation<'_> {
    /// True where the training of the agent diverged.
    fn diverged(&self) -> bool {
        self.rows.iter().any(|row| row.diverged_at_step.is_some())
    }
}

/// An evaluation beside its base.
struct Line<'a> {
    evaluation: &'a Evaluation<'a>,
    ratio: f64,
    /// Mean of the differences on the same track, and its standard error.
    difference: (f64, Option<f64>),
}

fn read<'a>(item: &InputItem<'a>, params: &CompareParams) -> Result<Evaluation<'a>, StageError> {
    let rows = scores::read(PORT, item.path)?;
    let scores: Vec<f64> = rows.iter().map(|row| row.score).collect();
    let summary = samples::summarise(&scores, item)?;
    let labels = item.labels.iter().map(|(name, value)| (name.as_str(), value.as_str()));
    let (axis, others): (Vec<_>, Vec<_>) = labels.partition(|(name, _)| *name == params.axis);
    let Some((_, value)) = axis.first() else {
        let seen = samples::describe(item.labels);
        let message = format!("an evaluation has no label `{}`; its labels are {seen}", params.axis);
        return Err(StageError::input(PORT, item.path, message));
    };
    Ok(Evaluation { item: *item, value, others, rows, summary })
}

/// The labels besides the axis, in the order of their names.
fn label_names<'a>(evaluations: &[Evaluation<'a>]) -> Vec<&'a str> {
    let mut names: Vec<&str> =
        evaluations.iter().flat_map(|evaluation| evaluation.others.iter().map(|(name, _)| *name)).collect();
    names.sort_unstable();
    names.dedup();
    names
}

fn lines<'a>(evaluations: &'a [Evaluation<'a>], params: &CompareParams) -> Result<Vec<Line<'a>>, StageError> {
    let line = |evaluation: &'a Evaluation<'a>| {
        let base = evaluations
            .iter()
            .find(|other| other.value == params.base && other.others == evaluation.others)
            .ok_or_else(|| {
                let labels = samples::describe(evaluation.item.labels);
                let message =
                    format!("nothing to compare ({labels}) with: no evaluation has {}={} and otherwise the same labels",
                        params.axis, params.base);
                StageError::input(PORT, evaluation.item.path, message)
            })?;
        let ratio = evaluation.summary.mean / base.summary.mean;
        Ok(Line { evaluation, ratio, difference: difference(evaluation, base)? })
    };
    evaluations.iter().map(line).collect()
}

fn difference(of: &Evaluation<'_>, base: &Evaluation<'_>) -> Result<(f64, Option<f64>), StageError> {
    let tracks =
        |evaluation: &Evaluation<'_>| -> Vec<u64> { evaluation.rows.iter().map(|row| row.seed).collect() };
    if tracks(of) != tracks(base) {
        let (ours, theirs) = (samples::describe(of.item.labels), samples::describe(base.item.labels));
        let message = format!(
            "({ours}) and ({theirs}) were played with different seeds; give them the same `first_seed` and `episodes`"
        );
        return Err(StageError::input(PORT, of.item.path, message));
    }
    let differences: Vec<f64> = of.rows.iter().zip(&base.rows).map(|(a, b)| a.score - b.score).collect();
    let summary = samples::summarise(&differences, &of.item)?;
    let n = summary.episodes as f64;
    // The sample's deviation, with divisor n - 1, over the root of n.
    let error = (summary.episodes > 1).then(|| summary.std / (n - 1.0).sqrt());
    Ok((summary.mean, error))
}

fn csv_text(
    params: &CompareParams,
    names: &[&str],
    lines: &[Line<'_>],
) -> Result<Vec<u8>, Box<dyn std::error::Error>> {
    let number = |value: f64| precise(value, params.decimals);
    let mut writer = csv::Writer::from_writer(Vec::new());
    writer.write_record(names.iter().copied().chain([params.axis.as_str()]).chain(VALUES))?;
    for line in lines {
        let labels = names.iter().map(|name| label(line, name)).chain([line.evaluation.value]);
        let summary = line.evaluation.summary;
        let (difference, error) = line.difference;
        let values = [
            number(summary.mean),
            number(summary.std),
            summary.episodes.to_string(),
            u8::from(line.evaluation.diverged()).to_string(),
            fixed(line.ratio, 4),
            number(difference),
            error.map_or_else(String::new, number),
        ];
        writer.write_record(labels.chain(values.iter().map(String::as_str)))?;
    }
    Ok(writer.into_inner()?)
}

fn label<'a>(line: &Line<'a>, name: &str) -> &'a str {
    line.evaluation.others.iter().find(|(other, _)| *other == name).map_or("", |(_, value)| value)
}

fn page(params: &CompareParams, names: &[&str], lines: &[Line<'_>]) -> String {
    let mut columns: Vec<Column> =
        names.iter().map(|name| Column::words(name, lines.iter().map(|line| label(line, name)))).collect();
    columns.push(Column::words(&params.axis, lines.iter().map(|line| line.evaluation.value)));
    let score = |line: &Line<'_>| Some(Score::measured(&line.evaluation.summary, params.decimals));
    let scores: Vec<_> = lines.iter().map(score).collect();
    columns.push(Column::scores("score", &scores));
    let is_base = |line: &Line<'_>| line.evaluation.value == params.base;
    columns.push(Column::words(
        "ratio",
        lines.iter().map(|line| match is_base(line) {
            true => String::new(),
            false => format!("{} %", fixed(100.0 * line.ratio, 1)),
        }),
    ));
    let points = |value: f64| fixed(value, usize::from(params.decimals) + 1);
    columns.push(Column::words(
        "difference",
        lines.iter().map(|line| match (is_base(line), line.difference) {
            (true, _) => String::new(),
            (false, (mean, Some(error))) => format!("{} ± {}", points(mean), points(error)),
            (false, (mean, None)) => points(mean),
        }),
    ));
    let base = escape(&format!("{} = {}", params.axis, params.base));
    let diverged = lines.iter().filter(|line| line.evaluation.diverged());
    let diverged: Vec<_> = diverged.map(|line| samples::describe(line.evaluation.item.labels)).collect();
    let mut remarks = vec![
        statistic(lines.iter().map(|line| line.evaluation.summary.episodes)),
        format!("ratio: the mean over that of {base}"),
        format!(
            "difference: score less that of {base} on the same track, mean ± standard error over the tracks"
        ),
    ];
    remarks.extend(divergence(&diverged));
    params.caption().page(&[], &markdown::table(&columns), &remarks)
}
