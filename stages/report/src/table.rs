//! The kind `table`: evaluations by their labels, next to published values.
//!
//! The CSV has one row per combination of keys; the Markdown shows the same as a grid.

use std::path::Path;

use dril_stage_api::{Artifact, Ctx, Describe, FanIns, InputItem, Ports, Problems, Stage, StageError};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use serde_json::Value;

use crate::caption::{self, Caption, divergence, statistic};
use crate::markdown::{self, escape};
use crate::number::precise;
use crate::pivot::{Cell, Pivot, Style, sort_by_appearance};
use crate::reference::{self, Published, Reference, Row};
use crate::samples::{self, Group, Sample};

/// The columns that follow the keys in the CSV.
const VALUES: [&str; 8] =
    ["mean", "std", "episodes", "trainings", "mean_error", "diverged", "reference_mean", "reference_std"];

/// Parameters of [`Table`].
#[derive(Clone, Debug, PartialEq, Deserialize, Serialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct TableParams {
    /// The title.
    pub title: String,
    /// The profile of the run; printed with the table.
    pub profile: String,
    /// The profile with the sizes of the experiment; at any other the table states that its sizes are reduced. Without it,
    /// these are `full` and `default`, the profile of a file without `profiles`.
    #[serde(default)]
    pub full_profile: Option<String>,
    /// The labels that identify a cell: the first columns of the CSV, in this order. Evaluations that differ only in other
    /// labels, such as a seed, are pooled into one cell.
    pub keys: Vec<String>,
    /// The keys that run across the Markdown table, outermost first; the others run down.
    #[serde(default)]
    pub columns: Vec<String>,
    /// The source of the published values, as the Markdown table names it.
    #[serde(default = "caption::reference_name")]
    pub reference_name: String,
    /// Decimals of this run's numbers in the Markdown table, 0 to 6. The CSV has two more.
    #[serde(default)]
    pub decimals: u8,
    /// A sentence to print under the Markdown table.
    #[serde(default)]
    pub note: String,
}

impl TableParams {
    fn caption(&self) -> Caption<'_> {
        let Self { title, profile, full_profile, note, .. } = self;
        Caption { title, profile, full_profile: full_profile.as_deref(), note }
    }
}

/// Makes a table of evaluations, beside published values of the same combinations.
///
/// Inputs: `scores`, any number of evaluations, each with its labels; `reference`, if given, a CSV file with the keys,
/// `mean` and, where it was published, `std` as columns. Rows of the reference that match no evaluation are left out; evaluations that match no
/// row of the reference have empty `reference_mean` and `reference_std`.
///
/// Outputs: `csv` with the columns `<keys>,mean,std,episodes,trainings,mean_error,diverged,reference_mean,reference_std`
/// (`mean`, `std` and `mean_error` with `decimals` + 2 decimals, published numbers as the reference writes them), and
/// `markdown`, the same with `decimals`. `std` is the population standard deviation over the episodes (see
/// [`crate::stats::Summary::std`]), `mean_error` the standard error of the mean over the trainings of the cell, and empty
/// for one training.
///
/// Rows and columns stand in the order in which their values first appear at the input, which is that of the matrix.
pub struct Table;

impl Describe for Table {
    const KIND: &'static str = "table";
    const REVISION: u32 = 4;
    const ABOUT: &'static str = "tabulates evaluations by their labels, next to published values";
    const SEEDED: bool = false;
    type Params = TableParams;

    fn check(params: &TableParams, problems: &mut Problems) {
        params.caption().check(problems);
        caption::check_decimals(params.decimals, problems);
        caption::check_reference_name(&params.reference_name, problems);
        check_keys(&params.keys, problems);
        for (n, column) in params.columns.iter().enumerate() {
            let path = format!("columns.{n}");
            if !params.keys.contains(column) {
                problems.add(
                    &path,
                    format!("`{column}` is not in `keys`, expected one of {}", list(&params.keys)),
                );
            }
            if params.columns[..n].contains(column) {
                problems.add(&path, format!("`{column}` is in `columns` twice, expected it once"));
            }
        }
    }

    fn check_labels(params: &TableParams, inputs: &FanIns<'_>, problems: &mut Problems) {
        samples::check_unique(samples::PORT, inputs, problems);
        for (n, key) in params.keys.iter().enumerate() {
            inputs.require(samples::PORT, key, &format!("keys.{n}"), problems);
        }
    }

    fn ports(_: &TableParams) -> Ports {
        Ports::new()
            .many(samples::PORT, Artifact::SCORES, "the evaluations; their labels say where each belongs")
            .optional(
                reference::PORT,
                Artifact::FILE,
                "published values: a CSV file of the keys, mean and std",
            )
            .output("csv", Artifact::TABLE, "csv", "one line a combination of the keys")
            .output("markdown", Artifact::TABLE, "md", "the same as a grid for people")
    }
}

impl Stage for Table {
    type Kind = Self;

    fn run(params: &TableParams, ctx: &mut Ctx<'_>) -> Result<(), StageError> {
        let samples = samples::read(ctx)?;
        let groups = pool(params, &samples)?;
        let reference = read_reference(params, ctx.optional_input(reference::PORT))?;
        let cells = cells(&groups, reference.as_ref());
        ctx.write_output("csv", csv_text(params, &cells).map_err(StageError::failed)?)?;
        let twins = twins(params, &samples, &cells)?;
        ctx.write_output("markdown", page(params, &samples, &cells, twins, reference.is_some()))
    }
}

/// The CSV of a table with these parameters over some of its evaluations, as the report shows a table whose stage waits for
/// the others. `None` for parameters of another kind.
///
/// # Errors
/// As those of the stage.
pub(crate) fn of_some(
    params: &Value,
    items: Vec<InputItem<'_>>,
    reference: Option<&Path>,
) -> Result<Option<Vec<u8>>, StageError> {
    let Ok(params) = serde_json::from_value::<TableParams>(params.clone()) else { return Ok(None) };
    let samples = items.into_iter().map(samples::sample).collect::<Result<Vec<_>, _>>()?;
    let groups = pool(&params, &samples)?;
    let reference = read_reference(&params, reference)?;
    csv_text(&params, &cells(&groups, reference.as_ref())).map(Some).map_err(StageError::failed)
}

fn pool(params: &TableParams, samples: &[Sample<'_>]) -> Result<Vec<Group>, StageError> {
    let hint = "take the key out of `keys`, or wire the input to stages that have that axis";
    samples::pool(samples, &params.keys, hint)
}

fn read_reference(params: &TableParams, path: Option<&Path>) -> Result<Option<Reference>, StageError> {
    let keys: Vec<&str> = params.keys.iter().map(String::as_str).collect();
    path.map(|path| Reference::read(path, &keys)).transpose()
}

fn check_keys(keys: &[String], problems: &mut Problems) {
    if keys.is_empty() {
        problems.add("keys", "`keys` is empty, expected at least one label");
    }
    for (n, key) in keys.iter().enumerate() {
        let path = format!("keys.{n}");
        if VALUES.contains(&key.as_str()) {
            problems.add(&path, format!("`{key}` is a column of the table itself, expected a label"));
        }
        if keys[..n].contains(key) {
            problems.add(&path, format!("`{key}` is in `keys` twice, expected it once"));
        }
    }
}

fn cells<'a>(groups: &[Group], reference: Option<&'a Reference>) -> Vec<Cell<'a>> {
    let cell = |group: &Group| Cell {
        key: group.key.clone(),
        summary: group.summary,
        published: reference.and_then(|reference| reference.get(&group.key)),
        trainings: group.evaluations,
        error: group.error,
        diverged: group.diverged,
    };
    let mut cells: Vec<Cell<'a>> = groups.iter().map(cell).collect();
    sort_by_appearance(&mut cells, |cell| &cell.key);
    cells
}

fn csv_text(params: &TableParams, cells: &[Cell<'_>]) -> Result<Vec<u8>, Box<dyn std::error::Error>> {
    let number = |value: f64| precise(value, params.decimals);
    let mut writer = csv::Writer::from_writer(Vec::new());
    writer.write_record(params.keys.iter().map(String::as_str).chain(VALUES))?;
    for cell in cells {
        let published = |number: fn(&Row) -> &Option<Published>| {
            cell.published.and_then(|row| number(row).as_ref()).map_or("", |number| number.text.as_str())
        };
        let (mean, std) = (number(cell.summary.mean), number(cell.summary.std));
        let episodes = cell.summary.episodes.to_string();
        let (trainings, diverged) = (cell.trainings.to_string(), cell.diverged.to_string());
        let error = cell.error.map_or_else(String::new, number);
        let (reference_mean, reference_std) = (published(|row| &row.mean), published(|row| &row.std));
        let values =
            [mean.as_str(), &std, &episodes, &trainings, &error, &diverged, reference_mean, reference_std];
        writer.write_record(cell.key.iter().map(String::as_str).chain(values))?;
    }
    Ok(writer.into_inner()?)
}

fn page(
    params: &TableParams,
    samples: &[Sample<'_>],
    cells: &[Cell<'_>],
    twins: Option<String>,
    with_reference: bool,
) -> String {
    let style = Style { source: &params.reference_name, decimals: params.decimals };
    let pivot = Pivot::new(&params.keys, &params.columns, style, cells);
    let mut remarks = vec![statistic(cells.iter().map(|cell| cell.summary.episodes))];
    if cells.iter().any(|cell| cell.trainings > 1) {
        remarks.push(pooling(samples, &params.keys));
    }
    remarks.extend(twins);
    remarks.extend(divergence(&diverged(&params.keys, cells)));
    if with_reference {
        remarks.push(format!("{}: {}", escape(&params.reference_name), coverage(cells)));
    }
    params.caption().page(&pivot.lead(), &markdown::table(&pivot.columns), &remarks)
}

/// Over what the evaluations of a cell were pooled.
fn pooling(samples: &[Sample<'_>], keys: &[String]) -> String {
    let axes = samples::pooled_over(samples, keys);
    let axes = axes.iter().map(|(axis, values)| escape(&format!("{axis} ({})", values.join(", "))));
    format!("the episodes of a cell are pooled over {}", axes.collect::<Vec<_>>().join(" and "))
}

/// Which cells pool evaluations of equal bytes; `None` where none does. Each counts as a training, so their error of the
/// mean would be far too small, mostly because a seed is a label of the matrix and no argument of the program.
fn twins(
    params: &TableParams,
    samples: &[Sample<'_>],
    cells: &[Cell<'_>],
) -> Result<Option<String>, StageError> {
    let mut found = Vec::new();
    for cell in cells.iter().filter(|cell| cell.trainings > 1) {
        let labels = || params.keys.iter().zip(&cell.key);
        let members = samples
            .iter()
            .filter(|sample| labels().all(|(key, value)| sample.item.labels.get(key) == Some(value)));
        let equal = samples::twins(members)?;
        if equal > 0 {
            let name = escape(&name(&params.keys, cell));
            found.push(format!("{equal} of the {} pooled into {name}", cell.trainings));
        }
    }
    let axes = samples::pooled_over(samples, &params.keys);
    let axes: Vec<String> = axes.iter().map(|(axis, _)| escape(axis)).collect();
    Ok((!found.is_empty()).then(|| {
        format!(
            "**equal evaluations**: {} have the same bytes as another one of the cell; if they should differ, check \
             that the value of {} reaches the program",
            found.join("; "),
            axes.join(" and ")
        )
    }))
}

/// The cells that hold agents whose training diverged.
fn diverged(keys: &[String], cells: &[Cell<'_>]) -> Vec<String> {
    cells.iter().filter(|cell| cell.diverged > 0).map(|cell| name(keys, cell)).collect()
}

/// `policy=beta, mode=stochastic`.
fn name(keys: &[String], cell: &Cell<'_>) -> String {
    let labels = keys.iter().zip(&cell.key).map(|(key, value)| format!("{key}={value}"));
    labels.collect::<Vec<_>>().join(", ")
}

/// For how many of the cells the reference has a value.
fn coverage(cells: &[Cell<'_>]) -> String {
    let known = |cell: &&Cell<'_>| cell.published.is_some_and(|row| row.mean.is_some());
    match (cells.iter().filter(known).count(), cells.len()) {
        (0, _) => "no value for any of these cells".to_owned(),
        (known, all) if known == all => "mean ± standard deviation as reported there".to_owned(),
        (known, all) => {
            format!("mean ± standard deviation as reported there, for {known} of the {all} cells")
        }
    }
}

fn list(names: &[String]) -> String {
    names.iter().map(|name| format!("`{name}`")).collect::<Vec<_>>().join(", ")
}
