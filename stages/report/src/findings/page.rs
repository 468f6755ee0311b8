//! Findings as CSV and as Markdown.

use std::collections::BTreeSet;
use std::path::Path;

use dril_stage_api::StageError;

use super::cells::{Cell, Pair, diverged};
use super::params::FindingsParams;
use super::test::{Differences, Measured, Verdict};
use crate::caption::{Caption, divergence};
use crate::inference::{self, Over};
use crate::markdown::{self, Column};
use crate::number::{fixed, precise};
use crate::reference::{Reference, Row};
use crate::samples::describe;

type Written = Result<Vec<u8>, Box<dyn std::error::Error>>;

/// A published difference, and half the width of its 95 % interval where standard deviations were published.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Published {
    pub(crate) difference: f64,
    pub(crate) half_width: Option<f64>,
}

/// All that there is to write.
pub(crate) struct Page<'a> {
    pub(crate) params: &'a FindingsParams,
    pub(crate) pairs: &'a [Vec<Pair<'a>>],
    pub(crate) measured: &'a [Measured],
    pub(crate) verdicts: &'a [(Verdict, Option<f64>)],
    /// For each claim, where all its cells were published.
    pub(crate) published: Vec<Option<Published>>,
}

/// The published difference of each claim.
///
/// # Errors
/// The reference cannot be read or lacks a label.
pub(crate) fn published(
    params: &FindingsParams,
    cells: &[Cell],
    pairs: &[Vec<Pair<'_>>],
    reference: Option<&Path>,
) -> Result<Vec<Option<Published>>, StageError> {
    let Some(path) = reference else { return Ok(vec![None; pairs.len()]) };
    let labels = labels(cells);
    let keys: Vec<&str> = labels.iter().copied().collect();
    let reference = Reference::read(path, &keys)?;
    let row = |cell: &&Cell| {
        let key: Vec<String> =
            keys.iter().map(|key| cell.labels.get(*key).cloned().unwrap_or_default()).collect();
        reference.get(&key).filter(|row| row.mean.is_some())
    };
    let value = |row: &Row| row.mean.as_ref().map_or(f64::NEG_INFINITY, |mean| mean.value);
    let best = |cells: &[&Cell]| -> Option<&Row> {
        let rows = cells.iter().map(row).collect::<Option<Vec<&Row>>>()?;
        rows.into_iter().reduce(|best, row| if value(row) > value(best) { row } else { best })
    };
    let episodes = f64::from(params.reference_episodes);
    let claim = |pairs: &Vec<Pair<'_>>| {
        let rows = pairs.iter().map(|pair| Some((best(&pair.left)?, best(&pair.right)?)));
        let rows = rows.collect::<Option<Vec<_>>>()?;
        let difference = inference::mean(&rows.iter().map(|(l, r)| value(l) - value(r)).collect::<Vec<_>>())?;
        let variance = |row: &Row| Some(row.std.as_ref()?.value.powi(2) / episodes);
        let variances = rows.iter().flat_map(|(left, right)| [variance(left), variance(right)]);
        let sum = variances.sum::<Option<f64>>();
        let error = sum.map(|sum| sum.sqrt() / rows.len() as f64);
        let half_width = error.map(|error| error * inference::quantile((episodes - 1.0).max(1.0), 0.05));
        Some(Published { difference, half_width })
    };
    Ok(pairs.iter().map(claim).collect())
}

/// All labels of the cells.
fn labels(cells: &[Cell]) -> BTreeSet<&str> {
    cells.iter().flat_map(|cell| cell.labels.keys()).map(String::as_str).collect()
}

/// Mean, lower and upper end, as cells of a table.
fn interval(mean: Option<f64>, half: Option<f64>, decimals: u8) -> [String; 3] {
    let number = |value: Option<f64>| value.map_or_else(String::new, |value| precise(value, decimals));
    let end = |sign: f64| number(mean.zip(half).map(|(mean, half)| mean + sign * half));
    [number(mean), end(-1.0), end(1.0)]
}

fn unit(over: Over) -> &'static str {
    match over {
        Over::Trainings => "trainings",
        Over::Episodes => "tracks",
    }
}

impl Page<'_> {
    /// One row per claim.
    pub(crate) fn csv(&self) -> Written {
        let mut writer = csv::Writer::from_writer(Vec::new());
        writer.write_record([
            "claim",
            "is",
            "verdict",
            "difference",
            "low",
            "high",
            "p",
            "n",
            "over",
            "pairs",
            "positive",
            "reference",
            "reference_low",
            "reference_high",
            "diverged",
        ])?;
        for (n, claim) in self.params.claims.iter().enumerate() {
            let (all, (verdict, p)) = (&self.measured[n].all, self.verdicts[n]);
            let [mean, low, high] = interval(all.mean(), all.half_width(), self.params.decimals);
            let published = self.published[n];
            let (reported, half) = (published.map(|p| p.difference), published.and_then(|p| p.half_width));
            let reference = interval(reported, half, self.params.decimals);
            let is = claim.is.words(claim.margin);
            let p = p.map_or_else(String::new, |p| fixed(p, 4));
            let (count, pairs) = (all.values.len().to_string(), self.pairs[n].len().to_string());
            let positive = self.positive(n).to_string();
            let text = markdown::one_line(&claim.claim);
            let cells = [
                &text,
                &is,
                verdict.name(),
                &mean,
                &low,
                &high,
                &p,
                &count,
                unit(all.over),
                &pairs,
                &positive,
            ];
            let diverged: usize = diverged(&self.pairs[n]).into_iter().map(Cell::diverged).sum();
            let diverged = diverged.to_string();
            let after = reference.iter().map(String::as_str).chain([diverged.as_str()]);
            writer.write_record(cells.into_iter().chain(after))?;
        }
        Ok(writer.into_inner()?)
    }

    /// One row per pair, with uncorrected intervals.
    pub(crate) fn pairs_csv(&self, cells: &[Cell]) -> Written {
        let labels = labels(cells);
        let mut writer = csv::Writer::from_writer(Vec::new());
        writer.write_record(["claim"].into_iter().chain(labels.iter().copied()).chain([
            "difference",
            "low",
            "high",
            "n",
        ]))?;
        for (n, claim) in self.params.claims.iter().enumerate() {
            for (pair, found) in self.pairs[n].iter().zip(&self.measured[n].pairs) {
                let values = labels.iter().map(|label| pair.shared.get(label).copied().unwrap_or_default());
                let numbers = interval(found.mean(), found.half_width(), self.params.decimals);
                let count = found.values.len().to_string();
                let text = markdown::one_line(&claim.claim);
                let line = [text.as_str()].into_iter().chain(values);
                writer
                    .write_record(line.chain(numbers.iter().map(String::as_str)).chain([count.as_str()]))?;
            }
        }
        Ok(writer.into_inner()?)
    }

    /// Of how many pairs the difference is above 0.
    fn positive(&self, claim: usize) -> usize {
        self.measured[claim].pairs.iter().filter_map(Differences::mean).filter(|mean| *mean > 0.0).count()
    }

    /// The cells of all claims with a training that diverged, each once.
    fn diverged(&self) -> Vec<String> {
        let mut names: Vec<String> = Vec::new();
        for cell in self.pairs.iter().flat_map(|pairs| diverged(pairs)) {
            let name = describe(&cell.labels);
            if !names.contains(&name) {
                names.push(name);
            }
        }
        names
    }

    /// The page for people.
    pub(crate) fn markdown(&self) -> String {
        let claims = &self.params.claims;
        let number = |value: f64| fixed(value, self.params.decimals.into());
        let around = |mean: Option<f64>, half: Option<f64>| match (mean, half) {
            (Some(mean), Some(half)) => format!("{} ± {}", number(mean), number(half)),
            (Some(mean), None) => number(mean),
            _ => String::new(),
        };
        let found = self.measured.iter().map(|found| around(found.all.mean(), found.all.half_width()));
        let published = self.published.iter();
        let published = published.map(|p| around(p.map(|p| p.difference), p.and_then(|p| p.half_width)));
        let p = self.verdicts.iter().map(|(_, p)| match p {
            Some(p) if *p < 0.0001 => "< 0.0001".to_owned(),
            Some(p) => fixed(*p, 4),
            None => String::new(),
        });
        let positive = (0..claims.len()).map(|n| format!("{} of {}", self.positive(n), self.pairs[n].len()));
        let mut columns = vec![
            Column::words("claim", claims.iter().map(|claim| &claim.claim)),
            Column::words("is", claims.iter().map(|claim| claim.is.words(claim.margin))),
            Column::words("verdict", self.verdicts.iter().map(|(verdict, _)| verdict.name())),
            Column::words("difference", found),
            Column::words("p", p),
            Column::words("positive", positive),
        ];
        if self.published.iter().any(Option::is_some) {
            columns.insert(4, Column::words("reported", published));
        }
        let mut remarks = vec![
            "difference: left − right, mean over the pairs of cells, with its 95 % interval (t)".to_owned(),
        ];
        let mut units: Vec<Over> = self.measured.iter().map(|found| found.all.over).collect();
        units.sort_unstable();
        units.dedup();
        remarks.extend(units.into_iter().map(|over| match over {
            Over::Trainings => format!("unit: the training, paired by {}", self.params.trainings.join(" and ")),
            Over::Episodes => {
                "unit: the track, paired; one training a cell, so it applies to these policies, not to the methods".to_owned()
            }
        }));
        remarks.push(format!("p: corrected by Holm over the {} claims; decided at 0.05", claims.len()));
        if self.measured.iter().any(|found| !found.all.is_enough()) {
            remarks.push(format!(
                "undecided without p: fewer than {} tracks or {} trainings",
                inference::FEWEST_EPISODES,
                inference::FEWEST_TRAININGS
            ));
        }
        remarks.extend(divergence(&self.diverged()));
        let FindingsParams { title, profile, full_profile, note, .. } = self.params;
        let caption = Caption { title, profile, full_profile: full_profile.as_deref(), note };
        caption.page(&[], &markdown::table(&columns), &remarks)
    }
}
