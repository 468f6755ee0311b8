//! The `scores` artifact: one row per evaluated episode, as CSV with the columns
//! `episode,seed,score,steps,outcome,diverged_at_step`. Files of earlier versions, with `track_seed` instead of `seed` and
//! without the last column, can be read, too.

use std::path::Path;

use serde::{Deserialize, Serialize};

use crate::{StageError, lines};

/// Every column that a file of scores can have. `track_seed` is an earlier name of `seed`.
pub const COLUMNS: [&str; 7] =
    ["episode", "seed", "score", "steps", "outcome", "diverged_at_step", "track_seed"];

/// The columns that it must have.
const REQUIRED: [&str; 5] = ["episode", "seed", "score", "steps", "outcome"];

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
    parse(&bytes).map_err(|message| StageError::input(port, path, message))
}

/// Checks the content of a file that another program wrote.
///
/// # Errors
/// As [`read`], without the path.
pub fn check(bytes: &[u8]) -> Result<(), String> {
    parse(bytes).map(drop)
}

fn parse(bytes: &[u8]) -> Result<Vec<ScoreRow>, String> {
    let mut reader = csv::Reader::from_reader(bytes);
    let unreadable = |error: &csv::Error, headers: Option<&csv::StringRecord>| {
        format!("not a table of scores: {}", lines::explain(error, bytes, headers))
    };
    let headers = reader.headers().map_err(|error| unreadable(&error, None))?.clone();
    if !headers.is_empty() {
        check_columns(&headers)?;
    }
    let rows: Result<Vec<ScoreRow>, csv::Error> = reader.deserialize().collect();
    let rows = rows.map_err(|error| unreadable(&error, Some(&headers)))?;
    if rows.is_empty() {
        return Err("has no episode, expected at least one".to_owned());
    }
    if let Some(row) = rows.iter().find(|row| !row.score.is_finite()) {
        return Err(format!("the score of episode {} is {}, expected a number", row.episode, row.score));
    }
    Ok(rows)
}

/// Every column is one of [`COLUMNS`], and those of [`REQUIRED`] are there.
fn check_columns(headers: &csv::StringRecord) -> Result<(), String> {
    let has = |column: &str| headers.iter().any(|header| header == column);
    let missing =
        REQUIRED.into_iter().filter(|column| !(has(column) || *column == "seed" && has("track_seed")));
    let unknown = headers.iter().filter(|header| !COLUMNS.contains(header));
    let list = |columns: &mut dyn Iterator<Item = &str>| {
        columns.map(|column| format!("`{column}`")).collect::<Vec<_>>().join(", ")
    };
    let (missing, unknown) = (list(&mut { missing }), list(&mut { unknown }));
    let expected = list(&mut REQUIRED.into_iter());
    let seen = match (missing.as_str(), unknown.as_str()) {
        ("", "") => return Ok(()),
        ("", unknown) => format!("it has the column {unknown}"),
        (missing, "") => format!("it has no column {missing}"),
        (missing, unknown) => format!("it has no column {missing}, but {unknown}"),
    };
    Err(format!("not a table of scores: {seen}; expected {expected} and perhaps `diverged_at_step`"))
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
            ("episode,seed,score,steps\n0,1,1,3\n", "it has no column `outcome`; expected `episode`, "),
            (
                "episode,seed,score,steps,outcome,x\n0,1,1,3,failed,\n",
                "it has the column `x`; expected `episode`",
            ),
            (
                "episode,sed,score,steps,outcome\n0,1,1,3,failed\n",
                "it has no column `seed`, but `sed`; expected",
            ),
        ] {
            std::fs::write(&path, text).unwrap();
            let message = read("scores", &path).unwrap_err().to_string();
            assert!(message.contains(part), "{text:?}: {message}");
        }
    }

    #[test]
    fn errors_name_the_line_whatever_ends_the_lines() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("scores.csv");
        let text = "episode,seed,score,steps,outcome\n0,1,1,3,failed\n\n1,2,x,3,failed\n";
        for end in ["\n", "\r\n", "\r"] {
            std::fs::write(&path, text.replace('\n', end)).unwrap();
            let message = read("scores", &path).unwrap_err().to_string();
            assert!(
                message.contains("line 4 in column `score`: invalid float literal"),
                "{end:?}: {message}"
            );
            std::fs::write(&path, text.replace(",x,3,failed", "").replace('\n', end)).unwrap();
            let message = read("scores", &path).unwrap_err().to_string();
            assert!(message.contains("line 4 has 2 cells, expected 5"), "{end:?}: {message}");
        }
    }
}
