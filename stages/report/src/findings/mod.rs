//! The kind `findings`: tests claims about evaluations as one family.

mod cells;
mod page;
mod params;
mod test;

use dril_stage_api::{Artifact, Ctx, Describe, FanIns, Ports, Problems, Stage, StageError};

use crate::{reference, samples};
pub use params::{Claim, FindingsParams, Relation, Value};
pub use test::Verdict;

/// Tests claims about differences between evaluations.
///
/// Inputs: `scores`, any number of evaluations, each with its labels, played on the same tracks; `reference`, if given,
/// a CSV file with all labels but those of trainings, `mean` and `std` as columns.
///
/// Outputs: `csv` with one row per claim, `pairs` with one row per pair of cells, `markdown` for people. `diverged` of the
/// CSV is the number of trainings on either side that diverged.
///
/// The difference of a claim is the mean over its pairs. With several trainings a cell, the unit is the training: the
/// differences of trainings with equal keys, with t over them. With one, it is the track: the differences on equal
/// tracks, with t over them, which holds for these policies only. The p values are corrected by Holm over all claims.
pub struct Findings;

impl Describe for Findings {
    const KIND: &'static str = "findings";
    const REVISION: u32 = 4;
    const ABOUT: &'static str = "tests claims about evaluations as one family, next to published values";
    const SEEDED: bool = false;
    type Params = FindingsParams;

    fn check(params: &FindingsParams, problems: &mut Problems) {
        params.check(problems);
    }

    fn check_labels(params: &FindingsParams, inputs: &FanIns<'_>, problems: &mut Problems) {
        samples::check_unique(samples::PORT, inputs, problems);
        params.check_labels(inputs, problems);
    }

    fn ports(_: &FindingsParams) -> Ports {
        Ports::new()
            .many(samples::PORT, Artifact::SCORES, "the evaluations; their labels say where each belongs")
            .optional(
                reference::PORT,
                Artifact::FILE,
                "published values: a CSV file of the labels, mean and std",
            )
            .output("csv", Artifact::TABLE, "csv", "one line a claim, with verdict, difference and interval")
            .output("pairs", Artifact::FILE, "csv", "one line a pair of cells of a claim")
            .output("markdown", Artifact::TABLE, "md", "the claims for people")
    }
}

impl Stage for Findings {
    type Kind = Self;

    fn run(params: &FindingsParams, ctx: &mut Ctx<'_>) -> Result<(), StageError> {
        let cells = cells::read(params, ctx)?;
        let pairs =
            params.claims.iter().map(|claim| cells::pairs(claim, &cells)).collect::<Result<Vec<_>, _>>()?;
        let measured: Vec<test::Measured> =
            params.claims.iter().zip(&pairs).map(|(claim, pairs)| test::measure(claim, pairs)).collect();
        let verdicts = test::verdicts(&params.claims, &measured);
        let published = page::published(params, &cells, &pairs, ctx.optional_input(reference::PORT))?;
        let page = page::Page { params, pairs: &pairs, measured: &measured, verdicts: &verdicts, published };
        ctx.write_output("csv", page.csv().map_err(StageError::failed)?)?;
        ctx.write_output("pairs", page.pairs_csv(&cells).map_err(StageError::failed)?)?;
        ctx.write_output("markdown", page.markdown())
    }
}
