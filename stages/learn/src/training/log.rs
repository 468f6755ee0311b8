//! The training log: one row for each update or epoch, the same columns for every kind of training it concerns.
//!
//! No clock reaches it: the log is an artifact, and equal work gives equal bytes. Speed goes to the progress line.

use std::collections::VecDeque;
use std::time::Instant;

use dril_stage_api::StageError;
use serde::{Deserialize, Serialize};

/// A table of numbers with named columns; grows row by row.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct TrainingLog {
    columns: Vec<String>,
    /// Empty cells are numbers that do not exist (no episode has ended yet).
    rows: Vec<Vec<Option<f64>>>,
}

impl TrainingLog {
    /// A log without rows.
    pub fn new(columns: &[&str]) -> Self {
        Self { columns: columns.iter().map(|&name| name.to_owned()).collect(), rows: Vec::new() }
    }

    /// The columns.
    pub fn columns(&self) -> &[String] {
        &self.columns
    }

    /// Appends a row, in the order of the columns; what is not finite becomes an empty cell.
    pub fn push(&mut self, row: &[f64]) {
        debug_assert_eq!(row.len(), self.columns.len());
        self.rows.push(row.iter().map(|&value| value.is_finite().then_some(value)).collect());
    }

    /// How many rows there are.
    pub fn len(&self) -> usize {
        self.rows.len()
    }

    /// True where there is no row.
    pub fn is_empty(&self) -> bool {
        self.rows.is_empty()
    }

    /// The cell of a column in the last row.
    pub fn last(&self, column: &str) -> Option<f64> {
        let index = self.columns.iter().position(|name| name == column)?;
        *self.rows.last()?.get(index)?
    }

    /// The CSV file: shortest decimal forms that read back to the same numbers.
    ///
    /// # Errors
    /// None that is known of.
    pub fn to_csv(&self) -> Result<Vec<u8>, StageError> {
        let mut writer = csv::Writer::from_writer(Vec::new());
        writer.write_record(&self.columns).map_err(StageError::failed)?;
        for row in &self.rows {
            let cells = row.iter().map(|cell| cell.map_or_else(String::new, |value| value.to_string()));
            writer.write_record(cells).map_err(StageError::failed)?;
        }
        writer.into_inner().map_err(StageError::failed)
    }
}

/// The scores of finished training episodes, in the order in which they ended.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct RecentScores {
    /// The newest hundred, oldest first.
    newest: VecDeque<f64>,
    /// How many have ended in all.
    pub episodes: u64,
}

impl RecentScores {
    /// Adds the score of an episode that ended.
    pub fn push(&mut self, score: f64) {
        if self.newest.len() == 100 {
            self.newest.pop_front();
        }
        self.newest.push_back(score);
        self.episodes += 1;
    }

    /// The score of the last one; not a number before the first.
    pub fn last(&self) -> f64 {
        self.newest.back().copied().unwrap_or(f64::NAN)
    }

    /// The mean over the last `count` (at most 100), or over all where there are fewer; not a number before the first.
    pub fn mean(&self, count: usize) -> f64 {
        let taken = count.min(self.newest.len());
        self.newest.iter().rev().take(taken).sum::<f64>() / taken as f64
    }
}

/// How fast a stage works, for the progress line only.
#[derive(Clone, Copy, Debug)]
pub struct Speed {
    start: Instant,
    done: u64,
}

impl Speed {
    /// Starts measuring when `done` steps are done.
    pub fn from(done: u64) -> Self {
        Self { start: Instant::now(), done }
    }

    /// Steps a second since then.
    pub fn at(&self, done: u64) -> f64 {
        (done - self.done) as f64 / self.start.elapsed().as_secs_f64().max(1e-3)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_file_holds_numbers_that_read_back_and_leaves_what_does_not_exist_empty() {
        let mut log = TrainingLog::new(&["update", "score"]);
        log.push(&[0.0, f64::NAN]);
        log.push(&[1.0, 0.1 + 0.2]);
        assert_eq!(
            String::from_utf8(log.to_csv().unwrap()).unwrap(),
            "update,score\n0,\n1,0.30000000000000004\n"
        );
        assert_eq!(log.last("score"), Some(0.1 + 0.2));
        assert_eq!(log.last("scores"), None);
    }

    #[test]
    fn a_mean_over_more_episodes_than_there_were_is_over_those_there_were() {
        let mut scores = RecentScores::default();
        assert!(scores.mean(10).is_nan() && scores.last().is_nan());
        (1..=150).for_each(|score| scores.push(f64::from(score)));
        assert_eq!((scores.last(), scores.episodes), (150.0, 150));
        assert_eq!(scores.mean(10), 145.5);
        assert_eq!(scores.mean(100), 100.5);
        let mut few = RecentScores::default();
        few.push(4.0);
        few.push(6.0);
        assert_eq!(few.mean(10), 5.0);
    }
}
