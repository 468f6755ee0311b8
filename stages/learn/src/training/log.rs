//! The training log: one row for each update or epoch.
//!
//! It contains no times: the log is an artifact, and equal work gives equal bytes. Speed is shown in the progress line.

use std::collections::VecDeque;
use std::fmt::{self, Display, Formatter};
use std::time::Instant;

use dril_stage_api::StageError;
use serde::{Deserialize, Serialize};

/// A table of numbers with named columns; grows row by row.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct TrainingLog {
    columns: Vec<String>,
    /// Empty cells are values that do not exist (no episode has ended yet).
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

    /// Appends a row, in the order of the columns; values that are not finite become empty cells.
    pub fn push(&mut self, row: &[f64]) {
        debug_assert_eq!(row.len(), self.columns.len());
        self.rows.push(row.iter().map(|&value| value.is_finite().then_some(value)).collect());
    }

    /// Number of rows.
    pub fn len(&self) -> usize {
        self.rows.len()
    }

    /// True if there is no row.
    pub fn is_empty(&self) -> bool {
        self.rows.is_empty()
    }

    /// The cell of a column in the last row.
    pub fn last(&self, column: &str) -> Option<f64> {
        let index = self.columns.iter().position(|name| name == column)?;
        *self.rows.last()?.get(index)?
    }

    /// The CSV file; numbers in the shortest form that reads back exactly.
    ///
    /// # Errors
    /// The rows cannot be serialised.
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
    /// The latest hundred, oldest first.
    newest: VecDeque<f64>,
    /// Total number of finished episodes.
    pub episodes: u64,
}

impl RecentScores {
    /// Adds the score of a finished episode.
    pub fn push(&mut self, score: f64) {
        if self.newest.len() == 100 {
            self.newest.pop_front();
        }
        self.newest.push_back(score);
        self.episodes += 1;
    }

    /// The latest score; NaN before the first.
    pub fn last(&self) -> f64 {
        self.newest.back().copied().unwrap_or(f64::NAN)
    }

    /// The mean over the latest `count` (at most 100) scores, or over all if there are fewer; NaN before the first.
    pub fn mean(&self, count: usize) -> f64 {
        let taken = count.min(self.newest.len());
        self.newest.iter().rev().take(taken).sum::<f64>() / taken as f64
    }
}

/// Measures the speed of a stage, for the progress line only.
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

/// Measures the speed of an on-policy training over whole updates, for the progress line only.
///
/// A rollout takes little time and the epochs after it much. A rate that includes a part of an update, as after a
/// resume, would be far too high or too low.
#[derive(Clone, Copy, Debug)]
pub struct UpdateSpeed {
    whole: Option<Speed>,
    rate: Option<f64>,
}

impl UpdateSpeed {
    /// Starts measuring after `done` steps; inside an update, at its end.
    pub fn from(done: u64, inside_update: bool) -> Self {
        Self { whole: (!inside_update).then(|| Speed::from(done)), rate: None }
    }

    /// Counts an update that ended after `done` steps of the training.
    pub fn update_ended(&mut self, done: u64) {
        match self.whole {
            Some(speed) => self.rate = Some(speed.at(done)),
            None => self.whole = Some(Speed::from(done)),
        }
    }
}

impl Display for UpdateSpeed {
    /// `, 104 steps/s`; nothing before the first whole update.
    fn fmt(&self, f: &mut Formatter<'_>) -> fmt::Result {
        self.rate.map_or(Ok(()), |rate| write!(f, ", {rate:.0} steps/s"))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_speed_of_a_training_that_resumed_inside_an_update_is_shown_after_the_first_whole_one() {
        let mut speed = UpdateSpeed::from(1_000, true);
        assert_eq!(speed.to_string(), "");
        speed.update_ended(1_100);
        assert_eq!(speed.to_string(), "", "the time of this update's first part is unknown");
        speed.update_ended(2_000);
        assert!(speed.to_string().ends_with(" steps/s"), "{speed}");
    }

    #[test]
    fn the_speed_of_a_new_training_is_shown_after_its_first_update() {
        let mut speed = UpdateSpeed::from(0, false);
        assert_eq!(speed.to_string(), "");
        speed.update_ended(1_000);
        assert!(speed.to_string().ends_with(" steps/s"), "{speed}");
    }

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
