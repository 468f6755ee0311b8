//! The `scores` artifact: one row per evaluated episode, as CSV with the columns
//! `episode,seed,score,steps,outcome,diverged_at_step`. Files of earlier versions, with `track_seed` instead of `seed` and
//! without the last column, can be read, too.

use std::path::Path;

use serde::{Deserialize, Serialize};

use crate::StageError;

/// One evaluated episode.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct ScoreRow {
    /// Index in the list of episodes, from 0.
    pub episode: usize,
    /// The environment seed, which determines the episode's track, terrain or level.
    #[serde(alias = "track_seed")]
    pub seed: u64,
    /// The sum of the environment's unmodified rewards.
    pub score: f64,
    /// Number of steps.
    pub steps: u64,
    /// How it ended: `finished`, `failed` or `time-limit`.
    pub outcome: String,
    /// The environment step at which the policy's training diverged, so that it has its last finite weights; empty
    /// otherwise.
    #[serde(default)]
    pub diverged_at_step: Option<u64>,
}

/// Writes the rows.
///
/// # Errors
/// The file cannot be written.
pub fn write(path: &Path, rows: &[ScoreRow]) -> Result<(), StageError> {
    let mut writer = csv::Writer::from_writer(Vec::new());
    for row in rows {
        writer.serialize(row).map_err(StageError::failed)?;
    }
    let bytes = writer.into_inner().map_err(StageError::failed)?;
    std::fs::write(path, bytes).map_err(StageError::io("cannot write", path))
}

/// Reads the rows.
///
/// # Errors
/// The file cannot be read, has no row, or has an invalid row.
pub fn read(port: &str, path: &Path) -> Result<Vec<ScoreRow>, StageError> {
    let bytes = std::fs::read(path).map_err(StageError::io("cannot read", path))?;
    let mut reader = csv::Reader::from_reader(bytes.as_slice());
    let rows: Result<Vec<ScoreRow>, csv::Error> = reader.deserialize().collect();
    let rows =
        rows.map_err(|error| StageError::input(port, path, format!("not a table of scores: {error}")))?;
    if rows.is_empty() {
        return Err(StageError::input(port, path, "has no episode, expected at least one"));
    }
    if let Some(row) = rows.iter().find(|row| !row.score.is_finite()) {
        let message = format!("the score of episode {} is {}, expected a number", row.episode, row.score);
        return Err(StageError::input(port, path, message));
    }
    Ok(rows)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn row(episode: usize, score: f64) -> ScoreRow {
        ScoreRow { episode, seed: 7, score, steps: 10, outcome: "finished".into(), diverged_at_step: None }
    }

    #[test]
    fn scores_are_read_back_to_the_last_bit() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("scores.csv");
        let marked = ScoreRow { diverged_at_step: Some(8192), ..row(2, 1e-300) };
        let rows = vec![row(0, 0.1 + 0.2), row(1, -100.0), marked];
        write(&path, &rows).unwrap();
        assert_eq!(read("scores", &path).unwrap(), rows);
    }

    #[test]
    fn scores_of_earlier_versions_are_read() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("scores.csv");
        std::fs::write(&path, "episode,track_seed,score,steps,outcome\n0,7,1.5,10,finished\n").unwrap();
        assert_eq!(read("scores", &path).unwrap(), [row(0, 1.5)]);
        write(&path, &[row(0, 1.5)]).unwrap();
        let text = std::fs::read_to_string(&path).unwrap();
        assert_eq!(text, "episode,seed,score,steps,outcome,diverged_at_step\n0,7,1.5,10,finished,\n");
    }

    #[test]
    fn an_empty_a_foreign_and_a_broken_file_are_refused_with_the_reason() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("scores.csv");
        for (text, part) in [
            ("", "has no episode"),
            ("episode,seed,score,steps,outcome\n", "has no episode"),
            ("a,b\n1,2\n", "not a table of scores"),
            ("episode,seed,score,steps,outcome\n0,1,NaN,3,finished\n", "expected a number"),
        ] {
            std::fs::write(&path, text).unwrap();
            let message = read("scores", &path).unwrap_err().to_string();
            assert!(message.contains(part), "{text:?}: {message}");
        }
    }
}
