//! The training output `episodes`: one row per finished episode (columns: [`dril_kinds::EPISODE_COLUMNS`]).

use dril_envs::FinishedEpisode;
use dril_kinds::EPISODE_COLUMNS;
use dril_stage_api::StageError;
use serde::{Deserialize, Serialize};

/// The finished episodes of a training, in the order in which they ended.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct EpisodeLog {
    rows: Vec<Row>,
    /// The first row that has no U-signal yet.
    unsigned: usize,
}

#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
struct Row {
    step: u64,
    update: u64,
    seed: u64,
    score: f64,
    length: usize,
    u_signal: Option<f64>,
}

impl EpisodeLog {
    /// Adds an episode that ended after `step` environment steps and `update` updates.
    pub fn push(&mut self, step: u64, update: u64, episode: &FinishedEpisode) {
        let &FinishedEpisode { seed, score, length, .. } = episode;
        self.rows.push(Row { step, update, seed, score, length, u_signal: None });
    }

    /// Adds the U-signals of the episodes that ended since the last call, in order; none if the training has no such signal.
    pub fn add_signals(&mut self, signals: &[f64]) {
        for (row, signal) in self.rows[self.unsigned..].iter_mut().zip(signals) {
            row.u_signal = Some(*signal);
        }
        self.unsigned = self.rows.len();
    }

    /// The CSV file; numbers in the shortest form that reads back exactly.
    ///
    /// # Errors
    /// The rows cannot be written as CSV.
    pub fn to_csv(&self) -> Result<Vec<u8>, StageError> {
        let mut writer = csv::Writer::from_writer(Vec::new());
        writer.write_record(EPISODE_COLUMNS).map_err(StageError::failed)?;
        for (episode, row) in self.rows.iter().enumerate() {
            let Row { step, update, seed, score, length, u_signal } = row;
            let signal = u_signal.map_or_else(String::new, |signal| signal.to_string());
            let cells = [
                episode.to_string(),
                step.to_string(),
                update.to_string(),
                seed.to_string(),
                score.to_string(),
                length.to_string(),
                signal,
            ];
            writer.write_record(&cells).map_err(StageError::failed)?;
        }
        writer.into_inner().map_err(StageError::failed)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use dril_envs::OwnedFrame;

    fn finished(seed: u64, score: f64) -> FinishedEpisode {
        FinishedEpisode { seed, score, length: 9, last_frame: OwnedFrame::Vector(Vec::new()) }
    }

    #[test]
    fn signals_belong_to_the_episodes_of_their_own_rollout() {
        let mut log = EpisodeLog::default();
        log.push(10, 0, &finished(7, 1.5));
        log.add_signals(&[0.5]);
        log.push(20, 1, &finished(8, -2.0));
        log.push(22, 1, &finished(9, 3.0));
        log.add_signals(&[1.0, -1.0]);
        log.push(30, 2, &finished(u64::MAX, 0.1 + 0.2));
        let text = String::from_utf8(log.to_csv().unwrap()).unwrap();
        let rows: Vec<&str> = text.lines().collect();
        assert_eq!(
            rows,
            [
                "episode,step,update,seed,score,length,u_signal",
                "0,10,0,7,1.5,9,0.5",
                "1,20,1,8,-2,9,1",
                "2,22,1,9,3,9,-1",
                "3,30,2,18446744073709551615,0.30000000000000004,9,",
            ]
        );
    }
}
