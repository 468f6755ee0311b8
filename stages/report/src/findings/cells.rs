//! Cells of evaluations, and the pairs of cells that a claim compares.

use std::collections::BTreeMap;

use dril_stage_api::{Ctx, StageError, scores};

use super::params::{Claim, FindingsParams, Value};
use crate::samples::{PORT, describe, unique};

/// One training of a cell: track and score of each episode.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct Training {
    /// The values of the labels that tell trainings apart.
    pub(crate) key: Vec<String>,
    pub(crate) episodes: Vec<(u64, f64)>,
    /// True where it diverged, so that its last finite weights were evaluated.
    pub(crate) diverged: bool,
}

/// The evaluations that agree in all labels but those of trainings.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct Cell {
    pub(crate) labels: BTreeMap<String, String>,
    pub(crate) trainings: Vec<Training>,
}

/// Two sides that agree in all labels that the claim does not name.
#[derive(Clone, Debug)]
pub(crate) struct Pair<'c> {
    /// The labels in which they agree.
    pub(crate) shared: BTreeMap<&'c str, &'c str>,
    /// The candidates of each side; more than one where the best is to be chosen.
    pub(crate) left: Vec<&'c Cell>,
    pub(crate) right: Vec<&'c Cell>,
}

impl Cell {
    /// How many of its trainings diverged.
    pub(crate) fn diverged(&self) -> usize {
        self.trainings.iter().filter(|training| training.diverged).count()
    }
}

/// The cells of these pairs with a training that diverged, each once.
pub(crate) fn diverged<'c>(pairs: &[Pair<'c>]) -> Vec<&'c Cell> {
    let mut cells: Vec<&Cell> = Vec::new();
    for cell in pairs.iter().flat_map(|pair| pair.left.iter().chain(&pair.right)) {
        if cell.diverged() > 0 && !cells.iter().any(|known| known.labels == cell.labels) {
            cells.push(cell);
        }
    }
    cells
}

/// Reads the evaluations at the input.
///
/// # Errors
/// A file that holds no scores, two with the same labels, or one without a label of trainings.
pub(crate) fn read(params: &FindingsParams, ctx: &Ctx<'_>) -> Result<Vec<Cell>, StageError> {
    let items = ctx.inputs(PORT);
    unique(PORT, &items)?;
    let mut cells: Vec<Cell> = Vec::new();
    for item in items {
        ctx.stop_if_cancelled()?;
        let rows = scores::read(PORT, item.path)?;
        let episodes = rows.iter().map(|row| (row.seed, row.score)).collect();
        let mut labels: BTreeMap<String, String> = item.labels.clone().into_iter().collect();
        let key = params.trainings.iter().map(|label| {
            labels.remove(label).ok_or_else(|| {
                let message =
                    format!("no label `{label}`, its labels are {}; see `trainings`", describe(item.labels));
                StageError::input(PORT, item.path, message)
            })
        });
        let diverged = rows.iter().any(|row| row.diverged_at_step.is_some());
        let training = Training { key: key.collect::<Result<_, _>>()?, episodes, diverged };
        match cells.iter_mut().find(|cell| cell.labels == labels) {
            Some(cell) => cell.trainings.push(training),
            None => cells.push(Cell { labels, trainings: vec![training] }),
        }
    }
    Ok(cells)
}

/// The pairs of a claim, in the order of the cells.
///
/// # Errors
/// A side has no cell, a cell has no counterpart, or there are several candidates without `best_of`.
pub(crate) fn pairs<'c>(claim: &'c Claim, cells: &'c [Cell]) -> Result<Vec<Pair<'c>>, StageError> {
    let is_on = |cell: &Cell, side: &BTreeMap<String, Value>| {
        side.iter()
            .chain(&claim.both)
            .all(|(label, value)| cell.labels.get(label) == Some(&value.to_string()))
    };
    let shared = |cell: &'c Cell| -> BTreeMap<&'c str, &'c str> {
        let free = |label: &String| {
            ![&claim.left, &claim.right].iter().any(|side| side.contains_key(label))
                && !claim.best_of.contains(label)
        };
        let kept = cell.labels.iter().filter(|(label, _)| free(label));
        kept.map(|(label, value)| (label.as_str(), value.as_str())).collect()
    };
    let mut pairs: Vec<Pair<'c>> = Vec::new();
    for cell in cells {
        let (left, right) = (is_on(cell, &claim.left), is_on(cell, &claim.right));
        if !left && !right {
            continue;
        }
        let labels = shared(cell);
        let at = pairs.iter().position(|pair| pair.shared == labels).unwrap_or_else(|| {
            pairs.push(Pair { shared: labels, left: Vec::new(), right: Vec::new() });
            pairs.len() - 1
        });
        if left {
            pairs[at].left.push(cell);
        }
        if right {
            pairs[at].right.push(cell);
        }
    }
    check(claim, &pairs)?;
    Ok(pairs)
}

/// Refuses pairs of which a side is empty, or holds several cells that nothing chooses from.
fn check(claim: &Claim, pairs: &[Pair<'_>]) -> Result<(), StageError> {
    let failed = |what: String| StageError::failed(format!("claim `{}`: {what}", claim.claim));
    if pairs.is_empty() {
        return Err(failed(
            "no evaluation is on either side; see the labels in `left`, `right` and `where`".into(),
        ));
    }
    for pair in pairs {
        let labels = pair
            .shared
            .iter()
            .map(|(label, value)| format!("{label}={value}"))
            .collect::<Vec<_>>()
            .join(", ");
        for (side, cells) in [("left", &pair.left), ("right", &pair.right)] {
            if cells.is_empty() {
                return Err(failed(format!("nothing is on the {side} for ({labels})")));
            }
            if cells.len() > 1 && claim.best_of.is_empty() {
                let several: Vec<String> = cells.iter().map(|cell| describe(&cell.labels)).collect();
                let message = format!(
                    "{} cells are on the {side} for ({labels}): {}; name one, or the labels to choose by in `best_of`",
                    cells.len(),
                    several.join("; ")
                );
                return Err(failed(message));
            }
        }
    }
    Ok(())
}
