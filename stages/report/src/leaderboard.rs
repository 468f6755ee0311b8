//! The kind `leaderboard`: published results of other methods, and under them the evaluations of this run.

use dril_stage_api::{Artifact, Ctx, Describe, FanIns, Ports, Problems, Stage, StageError};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use crate::caption::{self, Caption, OURS, divergence, statistic};
use crate::markdown::{self, Column};
use crate::number::precise;
use crate::reference::{self, Published, Reference, Row};
use crate::samples::{self, Group};
use crate::score::Score;

/// The label that names a row; a named fan-in of the pipeline file gives it to its items.
const NAME: &str = "name";
/// What to do about an evaluation without it.
const NAMELESS: &str = "give each item a name in the pipeline file, as in `scores: { some name: stage }`";
const COLUMNS: [&str; 8] =
    ["algorithm", "mean", "std", "episodes", "diverged", "source", "reference_mean", "reference_std"];

/// Parameters of [`Leaderboard`].
#[derive(Clone, Debug, PartialEq, Deserialize, Serialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct LeaderboardParams {
    /// The title.
    pub title: String,
    /// The profile of the run; printed with the table.
    pub profile: String,
    /// The profile with the sizes of the experiment; at any other the table states that its sizes are reduced. Without it,
    /// these are `full` and `default`, the profile of a file without `profiles`.
    #[serde(default)]
    pub full_profile: Option<String>,
    /// The source that this run reproduces: its rows of the reference are merged into the rows of this run with the same
    /// algorithm.
    #[serde(default = "caption::reference_name")]
    pub reference_name: String,
    /// Decimals of this run's numbers in the Markdown table, 0 to 6. The CSV has two more.
    #[serde(default)]
    pub decimals: u8,
    /// A sentence to print under the Markdown table.
    #[serde(default)]
    pub note: String,
}

impl LeaderboardParams {
    fn caption(&self) -> Caption<'_> {
        let Self { title, profile, full_profile, note, .. } = self;
        Caption { title, profile, full_profile: full_profile.as_deref(), note }
    }
}

/// Lists published results and those of this run, one row per algorithm.
///
/// Inputs: `scores`, evaluations with the label `name` (evaluations of one name are pooled); `reference`, a CSV file
/// with the columns `algorithm,mean,std,source`. First come the reference's rows in its own order, then this run's,
/// with source `this run`. A reference row whose source is `reference_name` and whose algorithm this run has too is shown beside
/// this run's row (`reference_mean`, `reference_std`) and not in one of its own.
///
/// Outputs: `csv` with the columns `algorithm,mean,std,episodes,diverged,source,reference_mean,reference_std` (this run's
/// numbers with `decimals` + 2 decimals, published ones as the reference writes them; `episodes` and `diverged` are empty for those),
/// and `markdown`.
pub struct Leaderboard;

impl Describe for Leaderboard {
    const KIND: &'static str = "leaderboard";
    const REVISION: u32 = 4;
    const ABOUT: &'static str = "lists published results, followed by evaluations of this run";
    const SEEDED: bool = false;
    type Params = LeaderboardParams;

    fn check(params: &LeaderboardParams, problems: &mut Problems) {
        params.caption().check(problems);
        caption::check_decimals(params.decimals, problems);
        caption::check_reference_name(&params.reference_name, problems);
    }

    fn check_labels(_: &LeaderboardParams, inputs: &FanIns<'_>, problems: &mut Problems) {
        samples::check_unique(samples::PORT, inputs, problems);
        if inputs.at(samples::PORT).iter().any(|incoming| !incoming.labels.contains_key(NAME)) {
            problems.add("", format!("an evaluation at `{}` has no name; {NAMELESS}", samples::PORT));
        }
    }

    fn ports(_: &LeaderboardParams) -> Ports {
        Ports::new()
            .many(
                samples::PORT,
                Artifact::SCORES,
                "the evaluations, each named: `scores: { some name: stage }`",
            )
            .input(
                reference::PORT,
                Artifact::FILE,
                "published results: a CSV file of algorithm, mean, std, source",
            )
            .output("csv", Artifact::TABLE, "csv", "one line an algorithm and source")
            .output("markdown", Artifact::TABLE, "md", "the same for people")
    }
}

impl Stage for Leaderboard {
    type Kind = Self;

    fn run(params: &LeaderboardParams, ctx: &mut Ctx<'_>) -> Result<(), StageError> {
        let samples = samples::read(ctx)?;
        let groups = samples::pool(&samples, &[NAME.to_owned()], NAMELESS)?;
        let reference = Reference::read(ctx.input(reference::PORT)?, &["algorithm", "source"])?;
        let entries = entries(&groups, &reference, &params.reference_name);
        ctx.write_output("csv", csv_text(params, &entries).map_err(StageError::failed)?)?;
        ctx.write_output("markdown", page(params, &entries))
    }
}

/// A row of the list.
enum Entry<'a> {
    Published(&'a Row),
    Ours { group: &'a Group, beside: Option<&'a Row> },
}

impl Entry<'_> {
    fn algorithm(&self) -> &str {
        match self {
            Self::Published(row) => &row.key[0],
            Self::Ours { group, .. } => &group.key[0],
        }
    }

    fn source(&self) -> &str {
        match self {
            Self::Published(row) => &row.key[1],
            Self::Ours { .. } => OURS,
        }
    }

    fn episodes(&self) -> Option<usize> {
        match self {
            Self::Published(_) => None,
            Self::Ours { group, .. } => Some(group.summary.episodes),
        }
    }

    /// How many of its evaluations are of an agent whose training diverged; `None` for what was published.
    fn diverged(&self) -> Option<usize> {
        match self {
            Self::Published(_) => None,
            Self::Ours { group, .. } => Some(group.diverged),
        }
    }

    /// What was published for a row of this run.
    fn beside(&self) -> Option<&Row> {
        match self {
            Self::Published(_) => None,
            Self::Ours { beside, .. } => *beside,
        }
    }

    fn score(&self, decimals: u8) -> Option<Score> {
        match self {
            Self::Published(row) => Score::published(row, decimals),
            Self::Ours { group, .. } => Some(Score::measured(&group.summary, decimals)),
        }
    }
}

fn entries<'a>(groups: &'a [Group], reference: &'a Reference, name: &str) -> Vec<Entry<'a>> {
    let beside_ours =
        |row: &&Row| row.key[1] == name && groups.iter().any(|group| group.key[0] == row.key[0]);
    let literature = reference.rows.iter().filter(|row| !beside_ours(row)).map(Entry::Published);
    let ours = groups.iter().map(|group| {
        let beside = reference.get(&[group.key[0].clone(), name.to_owned()]);
        Entry::Ours { group, beside }
    });
    literature.chain(ours).collect()
}

fn csv_text(
    params: &LeaderboardParams,
    entries: &[Entry<'_>],
) -> Result<Vec<u8>, Box<dyn std::error::Error>> {
    let number = |value: f64| precise(value, params.decimals);
    let mut writer = csv::Writer::from_writer(Vec::new());
    writer.write_record(COLUMNS)?;
    for entry in entries {
        let (mean, std) = match entry {
            Entry::Published(row) => (text(row.mean.as_ref()), text(row.std.as_ref())),
            Entry::Ours { group, .. } => (number(group.summary.mean), number(group.summary.std)),
        };
        let count = |number: Option<usize>| number.map_or_else(String::new, |n| n.to_string());
        let (episodes, diverged) = (count(entry.episodes()), count(entry.diverged()));
        let reference_mean = text(entry.beside().and_then(|row| row.mean.as_ref()));
        let reference_std = text(entry.beside().and_then(|row| row.std.as_ref()));
        let (algorithm, source) = (entry.algorithm(), entry.source());
        let ours = [algorithm, &mean, &std, &episodes, &diverged];
        writer.write_record(ours.into_iter().chain([source, &reference_mean, &reference_std]))?;
    }
    Ok(writer.into_inner()?)
}

fn text(number: Option<&Published>) -> String {
    number.map_or_else(String::new, |number| number.text.clone())
}

fn page(params: &LeaderboardParams, entries: &[Entry<'_>]) -> String {
    let decimals = params.decimals;
    let scores: Vec<Option<Score>> = entries.iter().map(|entry| entry.score(decimals)).collect();
    let beside = |entry: &Entry<'_>| Score::published(entry.beside()?, decimals);
    let beside: Vec<Option<Score>> = entries.iter().map(beside).collect();
    let table = markdown::table(&[
        Column::words("algorithm", entries.iter().map(Entry::algorithm)),
        Column::words("source", entries.iter().map(Entry::source)),
        Column::scores("score", &scores),
        Column::scores(&params.reference_name, &beside),
        Column::counts("episodes", entries.iter().map(Entry::episodes)),
    ]);
    let mut remarks = vec![
        statistic(entries.iter().filter_map(Entry::episodes)),
        "all other sources: mean ± standard deviation as reported there".to_owned(),
    ];
    let diverged = entries.iter().filter(|entry| entry.diverged().is_some_and(|count| count > 0));
    remarks.extend(divergence(&diverged.map(|entry| entry.algorithm().to_owned()).collect::<Vec<_>>()));
    params.caption().page(&[], &table, &remarks)
}
